"""The version of this package, alone: what recordings and results name needs nothing else of it."""

from __future__ import annotations

__version__ = "0.1.0"
"""By semantic versioning; the build reads it here."""

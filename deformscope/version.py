"""The version of this package, alone: what recordings and results name needs nothing else of it."""

from __future__ import annotations

__version__ = "0.1.0"
"""The one that `pyproject.toml` declares, by semantic versioning."""

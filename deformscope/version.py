"""The version of this package, in a module without imports: recordings and results name it."""

__version__ = "0.1.0"
"""By semantic versioning; the build reads it here."""

"""How soft a thing is, and where."""

__version__ = "0.1.0"

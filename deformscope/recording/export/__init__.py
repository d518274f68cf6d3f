"""A recording in other formats."""

"""A recording in formats of others."""

"""Data of others as frames like any device's."""

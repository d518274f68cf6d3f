"""Recordings in files and viewers, and reading them."""

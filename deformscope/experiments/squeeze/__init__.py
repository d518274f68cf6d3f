"""Squeezing a container to name its content (Thesis ch. 2)."""

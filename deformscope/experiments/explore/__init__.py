"""Exploring a surface by touch (Thesis ch. 4)."""

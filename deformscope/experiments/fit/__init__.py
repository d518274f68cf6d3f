"""Fits of what a camera saw, of pairs and of pokes (Thesis ch. 3)."""

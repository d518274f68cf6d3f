"""Meshless shape matching (MSM): clusters, the float64 reference that specifies it, and the warp engine.

The public names are re-exported lazily so that importing a sibling never imports warp.
"""

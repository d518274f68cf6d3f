"""Meshless shape matching (MSM): clusters, the float64 reference that specifies it, and the warp engine.

Nothing is re-exported here, so that importing a sibling never imports warp.
"""

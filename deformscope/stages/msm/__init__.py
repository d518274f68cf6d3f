"""Meshless shape matching (MSM): clusters, the float64 reference that specifies it, and the warp engine.

Nothing is re-exported here, so that importing a sibling never imports warp. In modules with kernels annotations are not
quoted: warp reads them while the closures are made."""

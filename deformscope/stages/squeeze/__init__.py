"""From a squeezed container's images and pressures to features and the name of its content (Thesis ch. 2)."""

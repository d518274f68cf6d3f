"""From squeezing a container: images and pressures to features, features to the name of its content (Thesis ch. 2)."""

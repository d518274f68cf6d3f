"""A measured body in another simulator: its mesh, and the parameters with which it answers the measured pokes."""

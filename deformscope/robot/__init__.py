"""How the robot touches: placement, supervision, preflight, and the touch itself, over the real drivers."""

"""From pokes with force to stiffness, and to pokes not yet made."""

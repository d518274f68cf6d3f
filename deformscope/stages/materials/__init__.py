"""What beta and theta leave out: direction, yielding, motion in time."""

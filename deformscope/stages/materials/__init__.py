"""Materials beyond beta and theta: direction, yielding, motion in time."""

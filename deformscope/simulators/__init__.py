"""Other simulators: the body's files for each, and the process in which one presses it."""

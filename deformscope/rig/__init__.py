"""Real devices: the rig file, the drivers that it names, and their measurements as frames."""

"""Real devices: the rig file, the drivers that it names, and what they measure as frames."""

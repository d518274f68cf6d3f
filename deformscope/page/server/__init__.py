"""The live page: one server on loopback, with the viewer, the state of the run, and commands to it."""

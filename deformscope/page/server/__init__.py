"""The live page: one server on loopback, of the viewer, of what goes on, and of commands to it."""

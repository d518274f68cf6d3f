"""A recording, in a file and in a viewer, and how it is read."""

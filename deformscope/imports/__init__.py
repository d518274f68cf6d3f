"""Imports data of other programs as frames, like those of a device."""

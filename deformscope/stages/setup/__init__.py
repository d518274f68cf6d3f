"""Geometry before an exploration: table, tip, camera, force sensor, clocks."""

"""Measurements of a rig's own set-up."""

"""Stages that run during a rig's recording, and again in its replay."""

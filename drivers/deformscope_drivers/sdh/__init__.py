"""Schunk's SDH and SDH2 hand: its motion. Its tactile pads have a controller and line of their own (package `dsa`)."""

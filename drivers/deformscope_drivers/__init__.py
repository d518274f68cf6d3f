"""Drivers for the sensors that deformscope reads. Nothing here imports deformscope, rerun or warp."""

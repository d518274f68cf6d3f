"""Decides whether a surface has one stiffness, regions, or stiffness that changes gradually."""

"""Whether a surface is of one stiffness, of regions, or changes gradually: the one place where that is decided."""

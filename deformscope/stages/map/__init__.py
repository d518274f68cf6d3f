"""From touches to maps of a surface, and to the next touch."""

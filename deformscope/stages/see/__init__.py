"""From images to points and particles."""

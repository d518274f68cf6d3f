"""What is recorded, in a file and before a viewer, and how it is read back."""

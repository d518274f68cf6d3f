"""What is in a container, from squeezing it (Thesis chapter 2): features in, classes with probabilities out."""

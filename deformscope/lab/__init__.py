"""The simulated laboratory: what the model is fitted to, made without the model."""

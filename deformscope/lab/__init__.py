"""The simulated laboratory: things that deform by continuum mechanics alone, unlike the model fitted to them."""

"""The simulated laboratory: things that deform by continuum mechanics, sharing nothing with the model that is fitted."""

"""The set-ups of the thesis, each a generator that wires pure stages together."""

"""The experiments of the thesis, each a generator that connects pure stages."""

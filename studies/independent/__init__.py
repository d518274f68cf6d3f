"""Generators that share no code with what is counted on them: neither with `deformscope.stages` nor with its lab."""

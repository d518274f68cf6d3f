"""How an exploration is recorded and shown: `layout` is what it brings to its recorder."""

"""How a squeeze is recorded and shown: `layout` is what it brings to its recorder."""

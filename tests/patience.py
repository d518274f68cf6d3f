"""How long a test waits for what must come: no limit on speed, but the end of a test that hangs."""

PATIENCE_S = 240.0

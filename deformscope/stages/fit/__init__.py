"""From observed particles to parameters with intervals and verdicts."""

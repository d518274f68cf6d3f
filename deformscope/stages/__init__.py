"""Pure stages: functions from arrays to immutable results. Nothing here uses frames, files, devices or rerun."""

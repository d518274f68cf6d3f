"""Pure stages: arrays in, frozen results out. Nothing here uses frames, files, devices or rerun."""

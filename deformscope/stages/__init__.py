"""Pure stages: arrays in, frozen results out. Nothing here knows of frames, files, devices or rerun."""

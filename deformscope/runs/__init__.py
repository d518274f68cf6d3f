"""What drives devices or a recording from the options to the result: explore, squeeze, record, calibrate, move."""

"""From the options to the result, with devices, files or a recording: explore, squeeze, record, calibrate, predict,
replay, move; and the results themselves."""

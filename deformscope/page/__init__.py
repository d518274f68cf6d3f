"""What pages show of runs, and what they ask of them: recording, exploring, squeezing, fits, playback."""

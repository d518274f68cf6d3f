"""Views of runs on pages, and commands from pages: recording, exploring, squeezing, playback."""

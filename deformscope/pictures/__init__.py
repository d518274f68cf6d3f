"""Results as pictures and words, the same for recordings, reports and figures."""

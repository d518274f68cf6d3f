"""Results as pictures and texts, which recordings, reports and figures share."""

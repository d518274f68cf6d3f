"""Files that people bring or take away: images, videos, pairs, motions, models."""

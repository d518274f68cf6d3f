"""Files of users: images, videos, pairs, motions, models."""

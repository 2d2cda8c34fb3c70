"""The finished sensor: every body at its place, what they share, how far apart they are."""

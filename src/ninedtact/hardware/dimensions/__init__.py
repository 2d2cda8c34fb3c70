"""The dimensions of each part: frozen dataclasses, every field with its range and its reason. Lengths in mm."""

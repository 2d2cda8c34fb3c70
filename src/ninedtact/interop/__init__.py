"""Doors to other tools: each module needs its own extra, and none is imported by the package itself."""

"""How to build a sensor, step by step, each with a picture of the parts in that state."""

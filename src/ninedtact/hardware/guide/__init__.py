"""How to build a sensor, step by step, each with an image of the parts in that state."""

"""Pictures of solids: shaded, exploded, cut open, drawn with dimensions."""

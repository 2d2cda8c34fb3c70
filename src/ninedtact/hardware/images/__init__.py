"""Images of solids: shaded, exploded, cut open."""

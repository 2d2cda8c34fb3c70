"""Pictures of solids: shaded, exploded, cut open."""

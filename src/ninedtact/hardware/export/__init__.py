"""One folder from which a print shop, a laser cutter and a board house can work."""

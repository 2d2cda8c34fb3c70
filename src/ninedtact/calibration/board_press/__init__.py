"""The board's imprints as drawn by the twin: how deep they are, and where lines of sight that converge show them."""

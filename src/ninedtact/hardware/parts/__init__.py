"""The solids, one file per part; build123d is loaded by whoever imports one of them."""

"""Limits of a press that both its fit and its certificate apply.

They stand apart from the fits, so that a certificate can be judged without the libraries that fit a press.
"""

MAX_MISSING_FRACTION = 0.10
"""Largest fraction of the pins that may be predicted instead of detected."""
MAX_ASYMMETRY = 0.08
"""Asymmetry of the bulge above which a press of the ball counts as sheared (straight real press 0.013, sheared one 0.22)."""

"""One press of the pin board → the lens: fit.py tells the story."""

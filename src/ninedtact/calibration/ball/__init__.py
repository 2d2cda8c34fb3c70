"""One press of a ball → the depth curve: fit.py tells the story."""

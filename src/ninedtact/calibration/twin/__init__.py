"""One ball press → the twin of the sensor: fit.py tells the story.

Contact mechanics and light are fitted together to the whole image of the press: where, how deep and how far dragged the
ball was, how thick the gel seems, and how brightness follows height. No rule about where the ball's disc ends is needed.
"""

"""One press of the pin board → the lens. In: the reference image and the image of the pressed board. Out: `BoardFit`, the pins
found to sub-pixel accuracy and the lens model through them, from `board_fit.fit_board`; `BoardNotFound` says what was
detected instead.
"""

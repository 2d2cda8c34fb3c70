"""One press of a ball of known radius → the depth curve. In: the reference image and the image of the pressed ball, rectified.
Out: `BallFit`, the depth curve with its errors, from `ball_fit.fit_ball`; `BallPressUnusable` says why an image cannot
calibrate depth.
"""

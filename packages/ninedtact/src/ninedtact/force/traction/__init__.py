"""Force without training: the tractions under a contact by constrained inversion of the gel's compliance.

A calibrated sensor's reading goes in (height, rectified image, reference image); pressure and shear maps, the wrench that they add
up to, its standard deviation and warnings come out. `estimator.py` is the algorithm from top to bottom;
`build_traction_force(shape, gel)` returns the estimator. Each stage is one file: `observation` (the signal on a grid of cells),
`force.contact_detection` (where pressure may act), `traction_from_brightness` (Gauss–Newton iteration and the
uncertainty of the wrench), `linearisation_and_qp` (one iteration with the prior, and its solution), and
`brightness_from_traction` (tractions → heights → light, and the substrate that the gel lies on).
"""

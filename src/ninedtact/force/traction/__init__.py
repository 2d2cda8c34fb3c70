"""Force without training: the tractions under a contact by constrained inversion of the gel's compliance.

A calibrated sensor's reading goes in (height, rectified image, reference image); pressure and shear maps, the wrench that they add
up to, its standard deviation and warnings come out. `estimator.py` is the algorithm top-down: `build_traction_force(shape, gel)`
returns it. Each stage is one file: `observation` (the signal on the grid of cells of `cell_grid`), `force.contact_detection` (where
pressure may act),
`inversion` (Gauss–Newton), `linearisation` (one iteration with the prior), `nonnegative_qp` (its solution), `forward_model`
(tractions → heights → light), `uncertainty`, and `substrate` (what the gel lies on).
"""

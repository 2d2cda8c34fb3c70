"""Force without training: the tractions under a contact by constrained inversion of the gel's compliance.

estimator.py    TractionForce, top-down; read this first
evidence.py     what is read: light, or heights; observation.py what a reading shows, on a grid of half-millimetre cells
gate.py         whether anything touches, and where
inversion.py    Gauss and Newton over the law of light; linearised.py one round; descent.py the search inside
forward.py      tractions → heights → light; brightness.py the law; cells.py the grid
blocks.py       the same problem, coarse: preconditioner and covariance (block_problem.py)
prior.py        what is known of presses; weigh.py how far each cell is believed; certainty.py how certain the wrench is
"""

"""Force without training: the tractions under a contact by constrained inversion of the gel's compliance.

estimator.py    TractionForce, top-down; read this first
evidence.py     what is read: light, or heights; observation.py what a reading shows, on a grid of cells of 0.7 mm
ground.py       what the gel lies on, and what a base that yields does to a calibration
gate.py         whether anything touches, and where
explained.py    where the search begins, when it ends, what it found
inversion.py    Gauss and Newton over the law of light; linearised.py one round; pivoting.py solves it outright
forward.py      tractions → heights → light; brightness.py the law; cells.py the grid; kernels.py what each cell does
prior.py        what is known of presses; weigh.py how far each cell is believed; certainty.py how certain the wrench is
"""

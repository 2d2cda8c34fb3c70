"""How the skin yields to what presses it: gel.py is the material, contact.py tells the story.

Axes as in the whole package: z outward through the skin. Pressure p ≥ 0 pushes inward (−z), shear traction (q_x, q_y) is
what the object applies to the skin, displacement u = (u_x, u_y, u_z) is of the skin. Fourier fields are ∝ e^{+ik·x} with
the forward transform unscaled, as NumPy's `rfft2`. Arrays are (…, rows, cols) of NumPy or torch; batches lead.
"""

"""Contact mechanics of the gel: rigid objects and poses go in, tractions, displacements and the wrench of each contact come
out.

`contact_model.ContactModel` is the file to read first: `step` takes the last contact, an `Indenter` and a `Pose` and returns
the next `Contact`. Below it are the skin (`layer_compliance`, `skin`), the objects
(`indenter` and its shapes, `pose`) and the solvers (`normal_contact`, `friction`, `active_region`).
Other packages import from these modules by name.

Axes as in the whole package: z outward through the skin. Pressure p ≥ 0 pushes inward (−z), shear traction (q_x, q_y) is
what the object applies to the skin, displacement u = (u_x, u_y, u_z) is of the skin. Fourier fields are ∝ e^{+ik·x} with the
forward transform unscaled, as NumPy's `rfft2`. Arrays are (…, rows, cols) of NumPy or torch; batches lead.
"""

"""Collecting: which moments of pressing, dragging and twisting an object by hand become training pairs.

In go merged frames and force/torque samples (`recording.merge_streams`); out come labelled images in a recording, which
`recording.saved_pairs` reads. Read `collector` first. `settings` has all limits, `tare` the reference images and the zero of the
force/torque sensor, `sample_faults` which samples and clocks are rejected, `pair_selection` which moments are saved, and
`pair_counts` how many pairs of which forces there are.
"""

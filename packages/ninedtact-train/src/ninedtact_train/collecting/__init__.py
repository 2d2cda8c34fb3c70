"""Collecting training pairs: selects the moments of pressing, dragging and twisting an object by hand that become pairs.

In go frames and force/torque samples; out come labelled images in a recording, which
`recording.collected_pairs` reads. Read `collector` first, whose `collect_pairs` does all of it. `pair_selection` has all limits,
selects the moments that are saved and counts the pairs by force, `collection_tare` takes the reference images and the zero of
the force/torque sensor, `collection_sources` opens the camera and the force/torque sensor.
"""

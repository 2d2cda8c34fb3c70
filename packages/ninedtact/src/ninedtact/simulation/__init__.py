"""The digital twin: rigid objects press a simulated sensor, and images and wrenches come out.

A `Twin` (twin.py, read it first) holds the gel, the brightness model, the lens and the noise of a sensor. `Twin.press` is the only
way to press one: an object (objects/catalogue.py, by name) at a pose or under a load gives a `Press`, whose corrected contact is
rendered and measured. A `ScriptedPress` and a `Trajectory` press step by step. renderer.py turns a contact into a raw image,
ground_truth.py into true heights and tractions. A `PressSequence` with the sources of simulated_sources.py stands in for a
camera and a force/torque sensor. gel_brightness.py and pixel_to_skin_map.py hold the optics; calibration_press_models.py predicts
the images that calibrate a twin; press_drawing.py plots.

Nothing here imports `shape` or `calibration`: if the twin used the reconstructor's depth curve, every round trip would agree by
construction.
"""

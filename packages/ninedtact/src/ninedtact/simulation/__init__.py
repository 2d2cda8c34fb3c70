"""The digital twin: rigid objects press a simulated sensor, and images and wrenches come out.

A `Twin` (twin.py, read it first) holds the gel, the brightness model, the lens and the noise of a sensor. An object
(objects/catalogue.py, by name), pressed by a `ScriptedPress` or along a `Trajectory`, gives a `Contact` of
`ninedtact.mechanics`; renderer.py turns it into a raw image, ground_truth.py into true heights and tractions. A
`PressSequence` with the sources of simulated_sources.py stands in for a camera and a force/torque sensor. gel_brightness.py
and pixel_to_skin_map.py hold the optics; sensor_population.py samples sensors within their manufacturing tolerances;
rectified_renderer.py and batched/ simulate many contacts at once; press_figures.py plots.

Nothing here imports `shape` or `calibration`: if the twin used the reconstructor's depth curve, every round trip would agree by
construction.
"""

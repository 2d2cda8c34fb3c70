"""The physics twin: what presses the skin, how the skin yields, and what the camera sees of it.

twin.py      Twin, a sensor that is not there: gel, light, lens, untouched image, noise; default_twin; read this first
press.py     Press, one press from above the skin to its end; gauges.py the four that calibrate a twin
image.py   Contact → image: light.py brightness, seeing.py lines of sight, view.py the lens, noise.py, untouched.py
truth.py     heights, pressure and shear on the grids on which a sensor answers
motion.py    where an object goes over time; stage.py one motion that several sources watch; pace.py their clock
camera.py    SimulatedCamera (FrameSource); force_torque.py SimulatedForceTorque (WrenchSource)
show.py      the objects of the demo; drawn_press.py, drawn_show.py  figures
objects/     what can press: generated shapes, meshes, Thingi10K models, each an `Indenter` of `ninedtact.mechanics`
population/  sensors that could be; dataset/  pairs of image and wrench

Nothing here knows `shape` or `calibration`: if the twin used the reconstructor's curve, every round trip would agree by
construction.
"""

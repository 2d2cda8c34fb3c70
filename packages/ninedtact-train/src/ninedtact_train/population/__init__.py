"""Many simulated sensors: sampled around those that people built, or as `ninedtact calibrate` fitted six real ones.

sensor_population.py   `sample_sensor`: all parameters of one sensor of a seed, and its twin; read this first
real_sensor_twins.py   the twins of six real sensors
rectified_renderer.py  their rectified grey images, rendered without a raw image in between
"""

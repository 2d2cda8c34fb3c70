"""Many simulated sensors: sampled around those that people built, or as `ninedtact calibrate` fitted six real ones.

sensor_population.py  `sample_sensor`: all parameters of one sensor of a seed, its twin and its rectified images; read this first
real_sensor_twins.py  the twins of six real sensors
"""

"""Many simulated sensors, sampled around those that people built.

sensor_population.py  `sample_sensor`: all parameters of one sensor of a seed, its twin and its rectified images; read this first
"""

"""The parts of a sensor, from one description: solids, rules, assembly, files for those who make them.

    SensorDesign ──▶ HardwareDesign ──rules──▶ parts ──▶ assembly ──▶ interference, figures, bill, folder of files

`design.py` is the file to read first. build123d is loaded by `parts`, `assembly`, `images`, `drawings`, `guide` and `export`
alone.
"""

"""Has the sensor changed since it was calibrated? In: a sensor folder and a reference image of today. Out: what was measured
(`reference_check.measure_drift`) and what it means, in words (`diagnosis.diagnose_drift`).
"""

"""Has the sensor changed since it was calibrated? In: a sensor folder and a reference image of today. Out: what was measured
(`drift_measurement.measure_drift`) and what it means, in words (`diagnosis_and_reference_check.diagnose_drift`).
"""

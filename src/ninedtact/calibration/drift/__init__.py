"""Has the sensor changed since it was calibrated? drift.py measures, findings.py says it in words."""

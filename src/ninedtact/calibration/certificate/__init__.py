"""The certificate of a calibration, as a page: page.py puts it together."""

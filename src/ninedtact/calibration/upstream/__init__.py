"""The original project's calibration folders: exchange.py reads and writes them."""

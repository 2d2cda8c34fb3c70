"""From four images to a calibrated sensor.

    board pressed ──board──▶ lens          ball pressed ──ball──▶ depth curve

flow.py           calibrate(): the whole, top-down
board/            pins found, ordered, centred; the lens fitted; the paper's own way
ball/             the contact circle, what the camera sees of the ball, the curve
record.py         what sensor.toml holds; sensor_folder.py reads it, written.py writes it
certificate/      the page a person reads, its drawings and its verdict
guidance.py       what to tell a person who calibrates with a camera
drift/            today's untouched skin against the calibrated one
upstream/         the original project's calibration folders
brightness.py     what a press changed, in grey levels of uniform light
"""

"""Calibration of a sensor: four images in, a sensor folder out.

    board pressed ──board──▶ lens          ball pressed ──ball, twin──▶ depth curve, digital twin

In: reference images without contact, one press of the pin board, one press of the ball (`procedure.CalibrationImages`). Out: a
`procedure.Calibration`, saved as a sensor folder (`save.save_sensor`) that `sensor_folder.load_sensor` reads again.

procedure.py         calibrate(), the whole from top to bottom; repeat_calibration() from a folder's own images
board/               pins detected and located, the lens fitted, the paper's method for comparison
ball/                the contact circle, the depth curve by physics or by the disc's geometry
twin/                contact mechanics and light, fitted to the presses; the lens refined with them
fits_to_sensor_toml.py        the fits as tables of sensor.toml
sensor_toml_schema.py  the schema of sensor.toml; sensor_folder.py reads the folder, save.py writes it
certificate/         checks, plots and the page that a person reads
second_press_plan.py what a second press would tell, computed before it is made
guidance.py          advice to a person who calibrates with a camera
drift/               today's reference image against the calibrated one
original_9dtact/     import and export of the original project's calibration folders
brightness_change.py  change by a press or since the calibration, pixel noise, unusable images
"""

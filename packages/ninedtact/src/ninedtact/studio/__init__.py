"""The live page of a sensor in the browser; no other package imports viser.

    threads of `live`:  Sensor ──read──▶ newest SensorSnapshot, WrenchSource ──read──▶ WrenchHistory
    page thread:        SensorSnapshot ──▶ PageMoment ──▶ each ViewerPage ──▶ its panels     at the display rate

A `Sensor` and wrench sources go in; a page comes out that shows image, heights, wrenches, rates and warnings, saves readings as
files, and presses a twin by hand. `page_controller` makes one moment of each refresh (read it first), and `viewer` shows it in one
browser, panel by panel. The panels are in `status_and_rates_panels`, `wrench_curves`, `view_panels`, `twin_press_panel` and
`recordings_panel`; `page_cards` fills in their pieces of HTML. `sensor_group` is what several sensors have in common, such as the
grip force. `reading_view` draws images and surface of one reading, `skin_fields` its pressure and shear, `scene_3d` the 3D scene.
`press_control` is what people do with a twin. `recording_player` makes moments of recordings, `saved_files` holds what is saved.
`guided_session` and `guided_page` are what guided procedures and their pages share: `calibration_session` with `calibration_page`,
and `force_calibration_session` with `force_calibration_page`. `sensor_page` is the live page, `page_server` the web server of all
pages: a guarded front, which tests what browsers send (`accepted_page_messages`), before viser.
"""

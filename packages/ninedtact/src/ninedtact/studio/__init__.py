"""The live page of a sensor in the browser; no other package imports viser.

    sensor thread:  Sensor ──read──▶ newest SensorSnapshot, estimates in a WrenchHistory    as fast as the camera
    force threads:  WrenchSource ──read──▶ WrenchHistory                                    one for each source
    page thread:    SensorSnapshot ──▶ PageMoment ──▶ each ViewerPage ──▶ its panels        at the display rate

A `Sensor` and wrench sources go in; a page comes out that shows image, heights, wrenches, rates and warnings, saves readings as
files, and presses a twin by hand. `sensor_poller` and `wrench_history` read in threads of their own. `page_controller` makes one
moment of each refresh (read it first), and `viewer` shows it in one browser, panel by panel. The panels are in `sensor_panels`,
`view_panels`, `twin_press_panel` and `recordings_panel`; `page_cards` fills in their pieces of HTML. `sensor_group` is what several
sensors have in common: their wrenches in one table and one plot, and the grip force. `reading_view` draws images and surface of
one reading, `skin_fields` its pressure and shear, `scene_3d` the 3D scene. `press_control` is what people do with a twin.
`page_recorder` writes recordings, `recording_player` makes moments of them, `saved_files` holds what is saved.
`guided_session` and `guided_page` are what guided procedures and their pages share: `calibration_session` with `calibration_page`,
and `force_calibration_session` with `force_calibration_page`. `page_and_server` is the page with its web server, `socket_guard`
says who may connect to it and how much clients may cost, `viser_internals` puts that guard under viser and holds everything else
that relies on parts of viser that it does not document.
"""

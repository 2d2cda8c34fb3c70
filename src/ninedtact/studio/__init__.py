"""The live page of a sensor in the browser; no other package imports viser.

    sensor thread:  Sensor ──read──▶ newest SensorSnapshot, estimates in a WrenchHistory    as fast as the camera
    force threads:  WrenchSource ──read──▶ WrenchHistory                                    one for each source
    page thread:    SensorSnapshot ──render──▶ ReadingView ──▶ browser                      at the display rate

A `Sensor` and wrench sources go in; a page comes out that shows image, heights, wrenches, rates and warnings, and saves readings as
files. `sensor_poller` and `wrench_poller` read in threads of their own. `displayed_reading` decides what is shown (read it first).
`page_and_server` is the page itself with its web server, `socket_guard` says who may connect to it and how much clients may cost,
`viser_guard` puts that guard under viser, `scene_3d` its 3D part, `page_cards` its pieces of HTML. `reading_view` renders one
reading.
"""

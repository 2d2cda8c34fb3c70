"""A sensor that is read in a thread of its own, for the page, ROS 2, Foxglove and the stream, and the guard of their web servers.

    sensor thread:  Sensor ──read──▶ newest SensorSnapshot          as fast as images arrive (`sensor_poller`)
    force threads:  WrenchSource ──read──▶ WrenchHistory            one for each source (`wrench_history`)

`reading_recorder` records what these threads read. `socket_guard` says who may connect to a server of readings, and how much its
clients may cost; `server_log` is what such a server says in the terminal.
"""

"""Force/torque sensors: what lies under the tactile sensor and tells the true wrench.

address.py        force_torque_for("bota:CONFIG" | "netft:HOST" | "onrobot:HOST" | "serial:PORT")
measured.py       measured(device, mount): device → reopened → trusted → mounted → tared, what collection reads
sensor.py         ForceTorqueSensor, a WrenchSource on a Line: stamps, silence, drop count
line.py           Line, what a driver does; bota.py netft.py serial_port.py are its members
serial_frames.py  the plain frame of serial_port.py, byte by byte
device_clock.py   arrival stamps with the transport's jitter taken out; numbers that were skipped
reopening.py      Reopening(source): survives an unplugged cable
trusted.py        Trusted(source): refuses saturated, frozen and jumping samples; Skipping(source) passes over them
mounted.py        Mounted(source): from the device's frame to the sensor's
tared.py          Tared(source): without what it read when nothing touched; how far that has wandered since

A device tells what loads its tool side, N and N·m, in its own frame about its own origin. `Mounted` makes of it what
`WrenchSource` promises: what the object applies to the skin, in the sensor frame.
"""

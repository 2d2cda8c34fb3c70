"""Recordings: what a sensor delivers, as one MCAP file of ROS 2 messages with the sensor folder attached.

In go a `FrameSource`, a `WrenchSource` and a sensor folder (`record`), or a person's presses (`collecting`). Out comes a file,
which `Recording` reads again, `RecordedFrameSource` plays as a camera, `export_recording` writes out as images and tables,
and `read_recorded_pairs` turns into training pairs. The public names are listed in `__init__.pyi`; each is loaded when it is
first used, because they need the libraries of the extra `recording`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

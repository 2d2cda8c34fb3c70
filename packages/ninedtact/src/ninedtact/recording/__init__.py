"""Recordings: what a sensor delivers, as one MCAP file of ROS 2 messages with the sensor folder attached.

    recorder         FrameSource, WrenchSource, sensor folder ──▶ file        (`record`; the file itself: `RecordingWriter`)
    reader           file ──▶ `Recording`: frames, wrenches, heights, labels, readings
    recorded_source  file ──▶ `RecordedFrameSource`, `RecordedWrenchSource`: a camera and a force/torque sensor that replay it
    summary          what `ninedtact info` prints of it

`export_recording` writes it out as images and tables, `write_whole_copy` what is whole of one that was cut short. The public names
are listed in `__init__.pyi`; each is loaded when it is first used, because they need the libraries of the extra `recording`.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

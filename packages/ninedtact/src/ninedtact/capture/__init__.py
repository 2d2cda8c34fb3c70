"""Capture: from a camera, a network stream, a file or a force/torque sensor to `Frame` and `Wrench` with their arrival times.

In goes an address as a person writes it (`source_from_address.camera_or_file_source`, `force_torque_sensor_for`). Out comes a
`FrameSource` or a `WrenchSource`, which is opened with `with` and read item by item. Each kind of source is one file
(`uvc_camera`, `raspberry_pi_camera`, `network_stream`, `strict_image_reading`, `video_file`); a new one is one more file and one
more line in `source_from_address.SOURCE_TYPES`. `frame_pacing` and `reconnecting` wrap any source. The modules are imported one by
one, because some of them load OpenCV; the names below load nothing.
"""

from ninedtact.capture.frame_source import (
    CameraLost,
    CameraNotFound,
    CameraSettings,
    FrameSource,
    SourceEnded,
    SourceNotOpen,
)
from ninedtact.capture.wrench_source import WrenchSampleRejected, WrenchSensorLost, WrenchSource

__all__ = [
    "CameraLost",
    "CameraNotFound",
    "CameraSettings",
    "FrameSource",
    "SourceEnded",
    "SourceNotOpen",
    "WrenchSampleRejected",
    "WrenchSensorLost",
    "WrenchSource",
]

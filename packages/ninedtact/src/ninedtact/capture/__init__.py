"""Capture: from a camera, a network stream, a file or a force/torque sensor to `Frame` and `Wrench` with their arrival times.

In goes an address as a person writes it (`source_from_address.camera_or_file_source`, `force_torque_sensor_for`). Out comes a
`FrameSource` or a `WrenchSource`, which is opened with `with` and read item by item. Each kind of source is one file
(`uvc_camera`, `raspberry_pi_camera`, `network_stream`, `video_file`; image files stand beside the interface in `frame_source`); a
new one is one more file and one more line in `source_from_address.SOURCE_TYPES`. `frame_pacing` and `reconnecting` wrap any source.
Other packages import from these modules by name.
"""

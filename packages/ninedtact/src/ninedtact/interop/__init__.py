"""Doors to other tools: each module needs its own extra, and none is imported by the package itself.

`ros2_topics_and_messages` turns a reading into ROS 2 messages (CDR bytes), and `dds` brings such bytes to ROS 2 without an
installation of ROS. `ros2_sensor` is a sensor on it, `foxglove` shows a sensor in Foxglove, and `reading_stream` serves readings
to programs in any language; `sensor_sharing` is what the three share. `mujoco` lets the bodies of a scene press a twin
(`mujoco_contacts` reads the scene, `geom_undersides` its shapes), and `rerun` writes files for the Rerun viewer.
"""

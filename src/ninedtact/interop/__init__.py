"""Doors to other programs: a running sensor in; ROS 2 messages on the network, or readings as JSON lines, out.

`ros2_messages` turns a reading into ROS 2 messages (CDR bytes), `dds` brings such bytes to ROS 2 without an installation of ROS,
and `reading_stream` serves readings to programs in any language. Nothing else of the package imports them; each needs an extra.
"""

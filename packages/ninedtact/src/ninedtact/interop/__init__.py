"""Doors to other tools: each module needs its own extra, and none is imported by the package itself.

`ros2_topics_and_messages` turns a reading into ROS 2 messages (CDR bytes), and `dds` brings such bytes to ROS 2 without an
installation of ROS. `ros2_sensor` is a sensor on it, `foxglove` shows a sensor in Foxglove, and `reading_stream` serves readings
to programs in any language; `reading_broadcast` is the thread and the queues of both. `mujoco` lets the bodies of a scene
press a twin (`mujoco_contacts` reads the scene, `geom_undersides` its shapes), `mujoco_batch` those of many scenes at once.
`edge_following_environment`, `ball_rolling_environment` and `peg_insertion_environment` are Gymnasium environments on the base of
`tactile_environment`, `lerobot` writes data sets, and `rerun` files for the Rerun viewer.
"""

"""Force/torque sensors: from an address (`netft:192.168.1.1`) to the wrench that the object applies to the skin.

In goes an address or a driver; out comes a `WrenchSource`. `wrench_source_from_address.force_torque_sensor_for` opens the device
that an address names; `untared_wrench_source_for` beside it adds reconnection and the change from the frame of the device to that
of the sensor. `sample_checks` rejects samples, `tare` measures the zero. Each driver is one file (`bota`, `netft`,
`serial_driver`); a new one is one more file with a `ForceTorqueDriver` (`driver_source`) and one more line in
`wrench_source_from_address.DRIVERS`.

A device reports the load on its tool side, N and N·m, in its own frame about its own origin; `MountedWrenchSource`
converts this to the wrench that `WrenchSource` promises.
"""

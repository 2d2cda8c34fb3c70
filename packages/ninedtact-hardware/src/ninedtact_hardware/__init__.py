"""The hardware of a sensor: a `SensorDesign` with the dimensions of its parts goes in, files for those who make them
come out.

    SensorDesign ──▶ HardwareDesign ──rules──▶ solids ──▶ assembly ──▶ checks, bill of materials, folder of files

Read `design` first, then `design_file`: `read_hardware_design` gives a `HardwareDesign`. `buildability` has its rules.
`buildable_design.BuildableDesign` builds and checks it, `design_folder.write_design_folder` writes its files, `fabrication_guide`
describes how to build it, `design_comparison` compares the designs of a `design_sweep`, `led_board` has the circuit board. Modules
whose names begin with `part_`, `sensor_assembly`, and what builds on them load build123d; `part_dimensions` does not.
"""

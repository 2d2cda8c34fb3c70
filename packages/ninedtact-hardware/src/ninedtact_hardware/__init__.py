"""The hardware of a sensor: a `SensorDesign` with the dimensions of its parts goes in, files for those who make them
come out.

    SensorDesign ──▶ HardwareDesign ──rules──▶ solids ──▶ assembly ──▶ checks, bill of materials, folder of files

Read `design` first: `read_hardware_design` gives a `HardwareDesign`. `buildable_design.BuildableDesign` builds and checks it,
`export.design_folder.write_design_folder` writes its files, `fabrication_guide` describes how to build it, `design_sweep` compares
designs, `led_board` makes the circuit board. build123d is loaded only by `parts`, `sensor_assembly`, `part_and_assembly_images`,
`drawings`, `fabrication_guide` and `export`.
"""

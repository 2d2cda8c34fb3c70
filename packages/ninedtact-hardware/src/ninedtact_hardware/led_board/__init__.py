"""The LED circuit board as code: a `LedBoardDesign` of a few choices goes in, the files that a board house needs come out.

Frame: millimetres, origin on the optical axis, x along the long side, y along the short one, seen from the gel ("top").
The USB mouth looks towards -y. Components below the board are placed in this same frame, not mirrored.

board_parameters chooses (outline, LED positions, widths, current, design rules); footprints, components, routing and
complete_layout turn the choices into copper; design_rule_check checks the copper; silkscreen, gerber_and_drill, kicad and
fabrication_files write it.
"""

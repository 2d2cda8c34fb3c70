"""The LED circuit board as code: from a few numbers to the files that a board house wants.

Frame: millimetres, origin on the optical axis, x along the long side, y along the short one, seen from the gel ("top"); the
USB mouth looks towards -y. Parts below the board are placed in this same frame, not mirrored.

design.py      what can be chosen: outline.py, lattice.py, manufacture.py; the original as a variant
netlist.py     which pins belong together
parts.py       what is bought; footprints.py, its pads
placement.py   where each part sits; pads.py, its pads on the board
ring_routes.py, driver_routes.py, usb_routes.py   tracks and vias; pour.py, the ground between them
layout.py      all of that, as copper
check.py       each net in one piece, none touching another, all far enough from edges and holes
current.py     resistor → current → brightness, heat, limits
designators.py the parts' names on the silkscreen, in the letters of lettering.py
export.py      write_led_board(): KiCad board, Gerbers, drill files, placement, parts list, image
"""

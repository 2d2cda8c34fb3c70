"""Dimensions of each part: frozen dataclasses in which every field states its bounds and its reason. Lengths in mm.

Tables of a design file go in, checked dimensions come out: `printed_and_cut_parts` (base, shell, isolation ring, window,
calibration board), `gels_and_moulds`, `bought_parts` (camera, LED board, fasteners); `bounds` holds their ranges.
"""

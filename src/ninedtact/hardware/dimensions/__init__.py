"""Dimensions of each part: frozen dataclasses in which every field states its bounds and its reason. Lengths in mm.

Tables of a design file go in, checked dimensions come out: `made_parts` (base, shell, isolation ring, window, calibration board,
gels and moulds), `bought_parts` (camera, LED board, fasteners); `bounds` holds their ranges.
"""

"""Dimensioned drawings of the parts that are made: a built part and its notes go in, an A3 sheet as SVG and PDF comes
out.

`drawing_sheet.DrawingSheet` lays out the views and the column of notes; read it first. `dimensioned_view` draws one
view with its dimensions, `part_geometry` extracts polylines and features from a solid.
"""

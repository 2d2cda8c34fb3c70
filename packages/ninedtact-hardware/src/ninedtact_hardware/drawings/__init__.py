"""Dimensioned drawings of the parts that are made: a built part and its notes go in, an A3 sheet as SVG and PDF comes out.

`drawing_sheet.DrawingSheet` lays out the views with their dimensions and the column of notes; `part_geometry` extracts polylines
and features from a solid.
"""

"""Rigid objects that press a simulated sensor, each an `Indenter` of `ninedtact.mechanics`.

A name goes in, an indenter comes out: `catalogue.indenter_from_name("gear_07")`. Names are those of primitives (`ball:4`),
generated objects by family and number (`gear_07`), and mesh files (`part.stl@in`).

To add a generated object: write a function (sample, grid) → heights in the file of its kind, and list it by its name in the table
at the end of that file; `catalogue.FAMILIES` then holds it. Such functions use `height_fields`.
"""

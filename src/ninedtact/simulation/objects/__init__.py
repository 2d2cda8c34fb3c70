"""Rigid objects to press with: a seeded family of shapes, meshes from files, models of Thingi10K.

named.py        what a person types → an object: `ball:4`, `gear_07`, `part.stl@in`; read this first
generated.py    object k of a seed, whatever else is asked for
families.py     all families: solids, punches, machine parts, lettering, patterns, rough surfaces, everyday things
grid.py        the grid that they are drawn on, and how their dimensions are drawn; outline.py shapes in the plane
mesh.py         a mesh's size, side and unit; raster.py triangles seen from below; mesh_file.py reads STL, OBJ, PLY and more
thingi.py       models of Thingi10K by number
"""

"""Files for manufacturing: a `BuildableDesign` goes in, one folder for print shop, laser cutter and board house comes out.

`design_folder.write_design_folder` writes it, with instructions for the shops. `part_files` has STEP, STL and DXF.
"""

"""Files for manufacturing: a `BuiltSensor` goes in, one folder for print shop, laser cutter and board house comes out.

`parts_folder.export_parts` writes it. `solid_files` has STEP and STL, `laser_cutting` DXF, `shop_notes` the
instructions for the shops.
"""

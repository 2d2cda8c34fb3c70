"""Dimensioned drawings of the parts that are made: what a shop measures against.

sheet.py    one part on A3: which views, where, at which scale; read this first
view_on_sheet.py  one view with its dimensions; table.py the column of text beside the views
views.py    a part as lines, seen from a side or cut open; features.py its round holes, corners and heights
"""

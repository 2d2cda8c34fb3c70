"""Data sets for training: built from any source, checked, shown, and read fast.

build.py     sources → one folder that Hugging Face `datasets` opens; read this first
sources/     where pairs come from: recordings, the original project's folders, other projects' episodes, the twin
rows.py      the nouns: a row, untouched skin, what is left out, and what can be wrong; columns.py the same as Parquet
parts.py     one part of a source as files of its own; folder.py where a build goes on after a stop
checks.py    what is looked for in each pair; check.py over a whole data set; report.py listed and counted
card.py      what a person reads
reader.py    a data set in training: names and wrenches in memory, images decoded once; decoded.py the files of those
heights.py   its images as heights on a network's grid, by each sensor's calibration; sensor_heights.py those of one file
sheet.py     some pairs as an image for a person
"""

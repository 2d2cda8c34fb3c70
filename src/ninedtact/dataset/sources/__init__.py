"""Where pairs come from; each kind of source is cut into parts that become one file each.

source.py    what every source answers, and what is stated about foreign ones (torque origin, axes, scale)
detect.py    which kind a path is
table.py     a data set of the twin, or one that was built before
tree.py      the original project's Dataset folder; pair_files.py one image and wrench of it
htt.py       force episodes of the Heterogeneous Tactile Transformer (.npz); frames.py reads their images one by one
episodes.py  recordings of `ninedtact collect` (.mcap)
"""

"""Solids of the parts: a buildable hardware design goes in, build123d solids come out.

`part_catalogue.build_parts` builds all of them. build123d is loaded by every module of this package.
"""

"""Recordings at the command line: collecting pairs, recording, replaying, exporting, and the data sets made of them."""

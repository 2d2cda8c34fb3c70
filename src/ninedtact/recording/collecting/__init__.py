"""Which moments of pressing, dragging and twisting by hand become pairs, and which are not to be trusted.

settings.py      what is asked for
feed.py          images and samples in one stream, live or in turn
wrench_track.py  the wrench at a moment between two samples
trust.py         samples that freeze, jump, saturate; clocks that drift
skin_seen.py     whether an image shows untouched skin
tare.py          the untouched skin, and the wrench of nothing
moment.py        an image and its wrench; rest.py: what moments without touch tell
worth.py         why to save a moment, and which contact it belongs to
counters.py      what was saved, per range of each axis
collector.py     Collector: all of it together; read this one first
"""

"""Pairs of image and wrench from the twins of a population.

job.py          the whole data set, made by several processes, gone on with after a stop; read this first
settings.py     what is asked for; folder.py where it is kept, and how it is known again
hand.py         how a person presses: how hard, where, how far dragged, twisted and tilted
touch.py        one object on one sensor, station by station
session.py      one sensor for some fifty pairs: touches, and what the sampling rule keeps of them; deck.py deals the objects
asking.py       what a session asks of its sensor (bench.py), and the processor's answers; together/ those of a GPU, to many at once
pair.py         one row; table.py rows as Parquet that Hugging Face `datasets` opens; card.py what a person reads
percentiles.py  the wrenches beside the real ones
"""

"""What was seen and felt, on disk: an episode is one MCAP file of ROS 2 messages, with the sensor's folder attached.

session.py      Session: what is said once about an episode, clocks included
messages.py     the nouns as ROS 2 messages, and back
episode.py      EpisodeWriter: a file that is good up to the last half second, however the program ends
growing_file.py whole records or none, also on a full disk
scan.py         what a file holds, finished or cut short; mend.py finishes one that was cut short
stored.py       Episode: the nouns of a file again
sensor_copy.py  the sensor's folder into the file, and out of it
replay.py       Replay, ReplayedWrenches: the sources once more
recorder.py     sources in, episode out
summary.py      rates, drops and gaps; export.py: images, tables and heights as files of their own
saved_pair.py   SavedPair, what `ninedtact collect` saves; episode_pairs.py: pairs_of(FILE) reads them
collecting/     which moments it saves
dataset/        pairs from any source as one data set, checked, shown, read in training
"""

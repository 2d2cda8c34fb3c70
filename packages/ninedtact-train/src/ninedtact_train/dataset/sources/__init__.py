"""Sources of pairs for `build_dataset`: paths go in (`find_sources`), `Source` objects that yield rows come out.

`source.py` says what every source answers and what a person may state about it. The kinds: recordings of `ninedtact collect`
and data sets of the same format, built or generated (`own_formats.py`), the original project's Dataset folder
(`original_9dtact.py`), force episodes of the Heterogeneous Tactile Transformer (`htt_episodes.py`).
"""

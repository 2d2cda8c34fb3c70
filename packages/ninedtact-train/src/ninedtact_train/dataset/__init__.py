"""Data sets for training force estimation: pairs of a rectified image and the wrench that acted when it was taken.

In go sources of pairs: recordings, folders of the original project, force episodes of other projects, other data sets
(`find_sources`, `build_dataset`) or simulated sensors (`generate_dataset`). Out comes one folder of Parquet files that Hugging
Face `datasets` opens (its columns: `schema.py`), checked (`check_dataset`) and read fast in training (`load_dataset`). The
public names are listed in `__init__.pyi`; each is loaded when it is first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Generation of data sets with simulated sensors: settings go in, a folder of pairs of image and exact wrench comes out.

`generate.py` makes the whole data set and continues one that was stopped; read it first. `settings.py` holds everything that
decides about the pairs. A session makes some fifty pairs with one sensor (`press_session.py`): it presses objects and keeps
what the sampling rule selects. Its contact steps and renders are requests, which `ninedtact_train.batched` answers one by
one on the processor or in batches on a GPU.
"""

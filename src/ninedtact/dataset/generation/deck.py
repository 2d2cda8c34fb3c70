"""Objects dealt out evenly: all of them once before any comes again."""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np

from ninedtact.dataset.generation.settings import DatasetSettings
from ninedtact.mechanics.indenter import Indenter
from ninedtact.simulation.objects.catalogue import indenter_from_name

APART = 7
"""How far on each session begins in the shuffled deck: about as many touches as it makes."""


@lru_cache(maxsize=64)
def object_of(name: str, seed: int) -> Indenter:
    """An object, made once; raises `ObjectUnknown`."""
    return indenter_from_name(name, seed)


def dealt(settings: DatasetSettings, session: int) -> Iterator[str]:
    """Names of objects for one session, without end."""
    names = settings.object_names
    deck = np.random.default_rng([settings.seed, 2]).permutation(len(names))
    at = session * APART
    while True:
        yield names[deck[at % len(names)]]
        at += 1

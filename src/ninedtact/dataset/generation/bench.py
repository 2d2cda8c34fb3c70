"""A sensor of the population, set up to be pressed and looked at."""

from functools import lru_cache

from ninedtact.dataset.generation.settings import DatasetSettings
from ninedtact.simulation.batched.requests import Bench
from ninedtact.simulation.rectified import grey_eye


def set_up(number: int, settings: DatasetSettings) -> Bench:
    """The sensor of this number."""
    sensor = settings.member(number)
    return Bench(sensor, sensor.twin(settings.pitch_mm), grey_eye(sensor, settings.size))


@lru_cache(maxsize=2)
def bench(number: int, settings: DatasetSettings) -> Bench:
    """The same, kept while the next one is in use."""
    return set_up(number, settings)

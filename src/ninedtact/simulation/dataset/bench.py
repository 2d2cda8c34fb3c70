"""A sensor of the population, set up to be pressed and looked at."""

from dataclasses import dataclass
from functools import lru_cache

from ninedtact.simulation.dataset.settings import DatasetSettings
from ninedtact.simulation.population.member import SensorMember
from ninedtact.simulation.rectified import GreyEye, grey_eye
from ninedtact.simulation.twin import Twin


@dataclass(frozen=True, eq=False)
class Bench:
    """Equal to itself alone, so that many sessions may be told apart by theirs."""

    member: SensorMember
    twin: Twin
    eye: GreyEye


def set_up(number: int, settings: DatasetSettings) -> Bench:
    """The sensor of this number."""
    sensor = settings.member(number)
    return Bench(sensor, sensor.twin(settings.pitch_mm), grey_eye(sensor, settings.size))


@lru_cache(maxsize=2)
def bench(number: int, settings: DatasetSettings) -> Bench:
    """The same, kept while the next one is in use."""
    return set_up(number, settings)

"""The settings of a generated data set and of its presses, which are stored with it.

The same settings and version generate the same data set again.
"""

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Float64
from msgspec import Meta
from numpy import ndarray as Array
from tyro.conf import Suppress, arg

from ninedtact.bounds import checks_arguments
from ninedtact.design import SensingArea, SensorDesign
from ninedtact_train.collecting.training_pair_rule import PairKindShares, SamplingRuleSettings
from ninedtact_train.population.mechanics_shares import MechanicsShares

if TYPE_CHECKING:
    from ninedtact_train.population.sensor_population import SampledSensor

_Count = Annotated[int, Meta(ge=1)]
_SidePx = Annotated[int, Meta(ge=16)]
_PUBLISHED_AREA_MM = SensingArea().size_mm
_Pair = tuple[float, float]


@dataclass(frozen=True)
class PressTarget:
    """What one step of a press aims at."""

    load_n: float
    shear_n: Float64[Array, "2"]
    twist_rad: float
    """Twist relative to the angle at which the object came down."""
    tilt_rad: Float64[Array, "2"]


@dataclass(frozen=True)
class PressSettings:
    """The distributions that press targets are sampled from: means and standard deviations."""

    load_n: _Pair = (6.7, 2.8)
    load_range_n: _Pair = (0.5, 11.5)
    shear_mean: _Pair = (0.03, -0.085)
    """Mean of shear over load along x and y, as measured with hand-held objects."""
    shear_spread: _Pair = (0.125, 0.145)
    twist_deg: float = 3.0
    max_twist_deg: float = 20.0
    tilt_deg: float = 3.0
    max_tilt_deg: float = 10.0
    position_spread_mm: _Pair = (4.5, 3.2)
    """Of the object's middle on the published sensing area; proportionally wider on a wider one."""
    targets: tuple[int, int] = (4, 8)
    """Fewest and most in one press."""
    steps: int = 2
    """From one target to the next."""
    max_depth: float = 0.75
    """Part of the gel's thickness at which a press stops: a hand feels the base there."""

    def sample_target(self, rng: np.random.Generator) -> PressTarget:
        """Sample the next target of a press."""
        load = float(np.clip(rng.normal(*self.load_n), *self.load_range_n))
        shear = load * rng.normal(self.shear_mean, self.shear_spread)
        limits = np.array([self.max_twist_deg, self.max_tilt_deg, self.max_tilt_deg])
        angles = np.clip(rng.normal(0, (self.twist_deg, self.tilt_deg, self.tilt_deg)), -limits, limits)
        return PressTarget(load, shear, float(np.radians(angles[0])), np.radians(angles[1:]))

    def sample_position(
        self, rng: np.random.Generator, max_offset_mm: Float64[Array, "2"], area_mm: _Pair = _PUBLISHED_AREA_MM
    ) -> _Pair:
        """Sample x and y in mm where the object comes down on a sensing area of this size."""
        scale = np.divide(area_mm, _PUBLISHED_AREA_MM)
        x, y = np.clip(rng.normal(0, self.position_spread_mm * scale), -max_offset_mm, max_offset_mm).tolist()
        return x, y


@checks_arguments
@dataclass(frozen=True)
class GenerationSettings:
    """Everything that decides about the bytes of a generated data set. Raises `InputError`."""

    pairs: _Count = 10_000
    """Number of images with their wrenches."""
    size: tuple[_SidePx, _SidePx] = (460, 345)
    """Columns and rows of the rectified images; images of every size show the width of the sensing area."""
    sensors: _Count = 20
    """Number of different sensors, which take turns."""
    objects: _Count = 175
    """Number of generated objects that are pressed; 175, as in the paper, unless objects are named."""
    object_names: tuple[str, ...] = ()
    """Objects by name in place of generated ones (ball:4, gear_07, part.stl)."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of sensors, presses and noise."""
    objects_seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of generated objects: a name and a seed are one shape in every data set."""
    shares: Annotated[PairKindShares, arg(name="")] = PairKindShares()
    mechanics: Annotated[MechanicsShares, arg(name="")] = MechanicsShares()
    """Shares of sensors whose gel is not linear on a rigid base."""
    light_below_n: Annotated[float, Meta(gt=0)] = 0.3
    """Load below which a pair counts as a light touch."""
    pitch_mm: Annotated[float, Meta(ge=0.05, le=1)] = 0.2
    """Pitch of the grid on which contacts are solved; a coarser one is faster."""
    session_pairs: _Count = 50
    """Pairs with one sensor before the next one's turn; fewer if otherwise not all sensors would have one."""
    sessions_per_file: _Count = 5
    """Sessions whose pairs are in one Parquet file."""
    design: Annotated[SensorDesign, Suppress] = SensorDesign()
    """The design that all sensors vary about."""
    rule: Annotated[SamplingRuleSettings, Suppress] = SamplingRuleSettings()
    press: Annotated[PressSettings, Suppress] = field(default_factory=PressSettings)

    @property
    def selected_objects(self) -> tuple[str, ...]:
        """Names of all objects that press."""
        from ninedtact.simulation.objects.catalogue import generated_object_names

        return self.object_names or tuple(generated_object_names(self.objects))

    @property
    def pairs_per_session(self) -> int:
        """Number of pairs of every session but the last, which may have fewer."""
        return max(1, min(self.session_pairs, self.pairs // self.sensors))

    @property
    def pairs_per_file(self) -> int:
        """Number of pairs of every file but the last, which may have fewer."""
        return self.pairs_per_session * self.sessions_per_file

    @property
    def files(self) -> int:
        """Number of files of pairs."""
        return -(-self.pairs // self.pairs_per_file)

    @property
    def sessions(self) -> int:
        """Number of sessions in all files."""
        return -(-self.pairs // self.pairs_per_session)

    def sensor_parameters(self, number: int) -> "SampledSensor":
        """Return all parameters of the sensor of this number."""
        from ninedtact_train.population.sensor_population import sample_sensor

        return sample_sensor(number, self.seed, self.mechanics, self.design)

    def sessions_of_file(self, file: int) -> range:
        """Return the numbers of the sessions whose pairs are in this file."""
        first = file * self.sessions_per_file
        return range(first, min(first + self.sessions_per_file, self.sessions))

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


@checks_arguments
@dataclass(frozen=True)
class SequenceSettings:
    """Everything that decides about the bytes of a data set of sequences. Raises `InputError`."""

    sequences: _Count = 160
    """Number of sequences of 1 to 2 s; the kinds of motion take turns."""
    size: tuple[_SidePx, _SidePx] = (460, 345)
    """Columns and rows of the rectified images; images of every size show the width of the sensing area."""
    sensors: _Count = 20
    """Number of different sensors, which take turns."""
    objects: _Count = 35
    """Number of generated objects, unless objects are named."""
    object_names: tuple[str, ...] = ()
    """Objects by name in place of generated ones (ball:4, gear_07, part.stl)."""
    seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of sensors, motions and noise."""
    objects_seed: Annotated[int, Meta(ge=0)] = 0
    """Seed of generated objects."""
    pitch_mm: Annotated[float, Meta(ge=0.05, le=1)] = 0.2
    """Pitch of the grid on which contacts are solved; a coarser one is faster."""
    load_n: Annotated[_Pair, Suppress] = (1.0, 8.0)
    speed_mm_s: Annotated[_Pair, Suppress] = (1.5, 20.0)
    friction: Annotated[_Pair, Suppress] = (0.2, 0.9)
    """Smallest and largest load, speed and friction coefficient, whose logarithms are uniform."""

    @property
    def sensors_and_objects(self) -> GenerationSettings:
        """The same of a data set of pairs, which makes the sensors and objects."""
        names = "size", "sensors", "objects", "object_names", "seed", "objects_seed", "pitch_mm"
        return GenerationSettings(**{name: getattr(self, name) for name in names})

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)

"""The settings of a generated data set and of its presses, which are stored with it.

The same settings and version generate the same data set again.
"""

from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array
from tyro.conf import Suppress, arg

from ninedtact.design import SensingArea, SensorDesign
from ninedtact.errors import InputError
from ninedtact_train.collecting.training_pair_rule import SamplingRuleSettings
from ninedtact_train.population.mechanics_shares import NonidealMechanicsShares

if TYPE_CHECKING:
    from ninedtact_train.population.sensor_population import SampledSensor

_SMALLEST_PX = 16
_PUBLISHED_AREA_MM = SensingArea().size_mm
_Pair = tuple[float, float]


class GenerationImpossible(InputError):
    """Raised for a data set that cannot be generated."""


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


@dataclass(frozen=True)
class PairKindShares:
    """The shares of pairs without contact and with a light touch, which the paper's sampling rule would not collect."""

    no_contact: float = 0.03
    """Share of pairs in which nothing touches and the wrench is zero."""
    light_touch: float = 0.05
    """Share of pairs whose load is below that of a light touch."""

    def __post_init__(self) -> None:
        if not (min(self.no_contact, self.light_touch) >= 0 and self.no_contact + self.light_touch <= 1):
            raise GenerationImpossible(
                f"expected shares from 0 to 1, together at most 1, got {self.no_contact} without contact and "
                f"{self.light_touch} touching lightly; correct them"
            )


@dataclass(frozen=True)
class GenerationSettings:
    """Everything that decides about the bytes of a generated data set."""

    pairs: int = 10_000
    """Number of images with their wrenches."""
    size: tuple[int, int] = (460, 345)
    """Columns and rows of the rectified images; images of every size show the width of the sensing area."""
    sensors: int = 20
    """Number of different sensors, which take turns."""
    objects: int = 175
    """Number of generated objects that are pressed; 175, as in the paper, unless objects are named."""
    object_names: tuple[str, ...] = ()
    """Objects by name in place of generated ones (ball:4, gear_07, part.stl)."""
    seed: int = 0
    """Seed of sensors, presses and noise."""
    objects_seed: int = 0
    """Seed of generated objects: a name and a seed are one shape in every data set."""
    shares: Annotated[PairKindShares, arg(name="")] = PairKindShares()
    mechanics: Annotated[NonidealMechanicsShares, arg(name="")] = NonidealMechanicsShares()
    """Shares of sensors whose gel is not linear on a rigid base."""
    light_below_n: float = 0.3
    """Load below which a pair counts as a light touch."""
    pitch_mm: float = 0.2
    """Pitch of the grid on which contacts are solved; a coarser one is faster."""
    session_pairs: int = 50
    """Pairs with one sensor before the next one's turn; fewer if otherwise not all sensors would have one."""
    sessions_per_file: int = 5
    """Sessions whose pairs are in one Parquet file."""
    design: Annotated[SensorDesign, Suppress] = SensorDesign()
    """The design that all sensors vary about."""
    rule: Annotated[SamplingRuleSettings, Suppress] = SamplingRuleSettings()
    press: Annotated[PressSettings, Suppress] = field(default_factory=PressSettings)

    def __post_init__(self) -> None:
        for name in ("pairs", "sensors", "objects", "session_pairs", "sessions_per_file"):
            if getattr(self, name) < 1:
                raise GenerationImpossible(
                    f"expected {name} of at least 1, got {getattr(self, name)}; give a larger number"
                )
        for name in ("seed", "objects_seed"):
            if getattr(self, name) < 0:
                raise GenerationImpossible(f"expected {name} of zero or more, got {getattr(self, name)}; give another")
        if min(self.size) < _SMALLEST_PX:
            raise GenerationImpossible(
                f"expected images of at least {_SMALLEST_PX} x {_SMALLEST_PX} pixels, got {self.size[0]} x {self.size[1]}; give "
                "columns and rows, as 460 345"
            )
        if not (self.light_below_n > 0 and 0.05 <= self.pitch_mm <= 1):
            raise GenerationImpossible(
                f"expected light touches below a load above zero and a grid pitch from 0.05 to 1 mm, got "
                f"{self.light_below_n} N and {self.pitch_mm} mm; correct them"
            )

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

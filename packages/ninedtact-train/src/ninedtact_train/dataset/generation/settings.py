"""The settings of a generated data set. They are stored with it; the same settings and version generate the same data set again."""

from dataclasses import asdict, dataclass, field
from typing import Any

from ninedtact.design import SensorDesign
from ninedtact.errors import InputError
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names
from ninedtact.simulation.twin import PITCH_MM
from ninedtact_train.collecting.training_pair_rule import SamplingRuleSettings
from ninedtact_train.dataset.generation.press_trajectory import PressSettings
from ninedtact_train.population.sensor_population import NonidealMechanicsShares, SampledSensor, sample_sensor

_SMALLEST_PX = 16


class GenerationImpossible(InputError):
    """Raised for a data set that cannot be generated."""


@dataclass(frozen=True)
class PairKindShares:
    """The shares of pairs without contact and with a light touch, which the paper's sampling rule would not collect."""

    no_contact: float = 0.03
    """Share of pairs in which nothing touches and the wrench is zero."""
    light_touch: float = 0.05
    """Share of pairs whose load is below `GenerationSettings.light_below_n`."""

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
    size: tuple[int, int] = (460, 345)
    """Columns and rows of the rectified images; images of every size show the width of the sensing area."""
    sensors: int = 20
    """Number of different sensors, which take turns."""
    objects: int = PAPER_COUNT
    """Number of generated objects; ignored if objects are named."""
    object_names: tuple[str, ...] = ()
    """Names of objects to use in place of the first `objects` generated ones."""
    seed: int = 0
    """Of sensors, presses and noise."""
    objects_seed: int = 0
    """Of generated objects: a name and a seed are one shape in every data set."""
    shares: PairKindShares = PairKindShares()
    mechanics: NonidealMechanicsShares = NonidealMechanicsShares()
    """Shares of sensors whose gel is not linear on a rigid base."""
    light_below_n: float = 0.3
    pitch_mm: float = PITCH_MM
    """Pitch of the grid on which contacts are solved."""
    session_pairs: int = 50
    """Pairs with one sensor before the next one's turn; fewer if otherwise not all sensors would have one."""
    sessions_per_file: int = 5
    design: SensorDesign = SensorDesign()
    """The design that all sensors vary about."""
    rule: SamplingRuleSettings = SamplingRuleSettings()
    press: PressSettings = field(default_factory=PressSettings)

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

    def sensor_parameters(self, number: int) -> SampledSensor:
        """Return all parameters of the sensor of this number."""
        return sample_sensor(number, self.seed, self.mechanics, self.design)

    def sessions_of_file(self, file: int) -> range:
        """Return the numbers of the sessions whose pairs are in this file."""
        first = file * self.sessions_per_file
        return range(first, min(first + self.sessions_per_file, self.sessions))

    def to_json_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)

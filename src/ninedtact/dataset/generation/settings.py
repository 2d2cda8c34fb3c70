"""What a data set is asked to be. The resolved settings are kept beside it: from them and the version it can be made again."""

from dataclasses import asdict, dataclass, field
from typing import Any

from ninedtact.capture.sampling_rule import SamplingRuleSettings
from ninedtact.dataset.generation.hand import Hand
from ninedtact.design import SensorDesign
from ninedtact.errors import NinedtactError
from ninedtact.simulation.objects.catalogue import PAPER_COUNT, generated_object_names
from ninedtact.simulation.sensor_population import MechanicsShares, SampledSensor, sample_sensor
from ninedtact.simulation.twin import PITCH_MM

FEWEST_PX = 16


class DatasetImpossible(NinedtactError):
    """A data set that cannot be made."""


@dataclass(frozen=True)
class Shares:
    """The part of all pairs that the paper's rule would not collect."""

    no_contact: float = 0.03
    """Nothing touches, and the wrench is zero."""
    light_touch: float = 0.05
    """The load is below `DatasetSettings.light_below_n`."""

    def __post_init__(self) -> None:
        if not (min(self.no_contact, self.light_touch) >= 0 and self.no_contact + self.light_touch <= 1):
            raise DatasetImpossible(
                f"expected shares from 0 to 1, together at most 1, got {self.no_contact} without contact and "
                f"{self.light_touch} touching lightly; correct them"
            )


@dataclass(frozen=True)
class DatasetSettings:
    """All that decides about its bytes."""

    pairs: int = 10_000
    size: tuple[int, int] = (460, 345)
    """Columns and rows of the rectified images; all sizes show the width of the sensing area."""
    sensors: int = 20
    objects: int = PAPER_COUNT
    """The first so many generated objects; ignored where names are given."""
    names: tuple[str, ...] = ()
    """Objects by name, in place of the first `objects` ones."""
    seed: int = 0
    """Of sensors, hands and noise."""
    objects_seed: int = 0
    """Of generated objects: one name and one such seed, one shape, whatever the data set."""
    shares: Shares = Shares()
    kinds: MechanicsShares = MechanicsShares()
    light_below_n: float = 0.3
    pitch_mm: float = PITCH_MM
    """Of the grid on which contacts are solved."""
    session_pairs: int = 50
    """With one sensor, before the next one's turn; fewer where not all sensors would have one."""
    sessions_per_file: int = 5
    design: SensorDesign = SensorDesign()
    """What all sensors were meant to be."""
    rule: SamplingRuleSettings = SamplingRuleSettings()
    hand: Hand = field(default_factory=Hand)

    def __post_init__(self) -> None:
        for name in ("pairs", "sensors", "objects", "session_pairs", "sessions_per_file"):
            if getattr(self, name) < 1:
                raise DatasetImpossible(f"expected {name} of at least 1, got {getattr(self, name)}; ask for more")
        if self.seed < 0:
            raise DatasetImpossible(f"expected a seed of zero or more, got {self.seed}; give another")
        if min(self.size) < FEWEST_PX:
            raise DatasetImpossible(
                f"expected images of at least {FEWEST_PX} x {FEWEST_PX} pixels, got {self.size[0]} x {self.size[1]}; give "
                f"columns and rows, as 460 345"
            )
        if not (self.light_below_n > 0 and 0.05 <= self.pitch_mm <= 1):
            raise DatasetImpossible(
                f"expected light touches below a load above zero and a grid pitch from 0.05 to 1 mm, got "
                f"{self.light_below_n} N and {self.pitch_mm} mm; correct them"
            )

    @property
    def object_names(self) -> tuple[str, ...]:
        """All of them."""
        return self.names or tuple(generated_object_names(self.objects))

    @property
    def pairs_per_session(self) -> int:
        """All sessions but the last hold as many."""
        return max(1, min(self.session_pairs, self.pairs // self.sensors))

    @property
    def pairs_per_file(self) -> int:
        """All files but the last hold as many."""
        return self.pairs_per_session * self.sessions_per_file

    @property
    def files(self) -> int:
        """How many."""
        return -(-self.pairs // self.pairs_per_file)

    @property
    def sessions(self) -> int:
        """How many, the last one perhaps shorter."""
        return -(-self.pairs // self.pairs_per_session)

    def member(self, number: int) -> SampledSensor:
        """The sensor of this number."""
        return sample_sensor(number, self.seed, self.kinds, self.design)

    def sessions_of(self, file: int) -> range:
        """Numbers of the sessions whose pairs are in this file."""
        first = file * self.sessions_per_file
        return range(first, min(first + self.sessions_per_file, self.sessions))

    def as_table(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return asdict(self)

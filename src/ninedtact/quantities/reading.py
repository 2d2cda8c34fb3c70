"""All that one frame gave."""

from dataclasses import dataclass, field

from ninedtact.quantities.force import WrenchEstimate
from ninedtact.quantities.shape import Frame, HeightMap, Rectified


@dataclass(frozen=True)
class Reading:
    """All that one frame gave, what each stage cost, and how old it is."""

    frame: Frame
    rectified: Rectified
    height: HeightMap
    stage_ms: dict[str, float] = field(default_factory=dict)
    dropped: int = 0
    """Frames that the source delivered and nobody read, since the source was opened."""
    reference: Rectified | None = None
    """The untouched skin that this reading was held against."""
    force: WrenchEstimate | None = None
    """Where the sensor has an estimator."""

    def age_ms(self, now_ns: int) -> float:
        """Time since the frame arrived, against `time.monotonic_ns()`."""
        return (now_ns - self.frame.stamp_ns) / 1e6

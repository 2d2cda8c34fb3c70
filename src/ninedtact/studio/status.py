"""How the sensor is doing, in one sentence and one colour."""

from dataclasses import dataclass
from typing import Literal

from ninedtact.reading import Reading
from ninedtact.studio.loop import Moment, Phase

SILENT_AFTER_MS = 1000.0
"""Ten images of the slowest camera in use. A person then no longer takes what is shown for the present."""

Tone = Literal["live", "busy", "held", "lost"]


@dataclass(frozen=True)
class Status:
    """What a person must know before believing anything else on the page."""

    tone: Tone
    sentence: str

    @property
    def is_past(self) -> bool:
        """Whether what is shown is not the present, although nobody asked for that."""
        return self.tone == "lost"


WAITING = Status("busy", "waiting for the first image…")


def status_of(moment: Moment, shown: Reading | None, frozen: bool, now_ns: int) -> Status:
    """The most urgent thing first."""
    silent_ms = (now_ns - moment.heard_ns) / 1e6
    reading = shown or moment.reading
    age_ms = reading.age_ms(now_ns) if reading is not None else 0.0
    if moment.phase is Phase.FAILED:
        return last_words(moment)
    if moment.phase is Phase.ENDED:
        return Status("held", f"recording ended, its last image is shown ({duration(age_ms)} old)")
    if silent_ms > SILENT_AFTER_MS:
        return Status("lost", f"no image for {duration(silent_ms)}: unplugged? reconnecting…")
    if moment.phase is Phase.REFERENCE:
        return taking_reference(moment.trouble)
    if reading is None:
        return WAITING
    if frozen:
        return Status("held", f"frozen, what is shown is {duration(age_ms)} old")
    return Status("live", f"live, {age_ms:.0f} ms old")


def last_words(moment: Moment) -> Status:
    """What a page says for good when nothing will come any more."""
    return Status("lost", f"stopped: {moment.trouble if moment.phase is Phase.FAILED else 'the program has ended'}")


def taking_reference(trouble: BaseException | None) -> Status:
    """While the untouched skin is being taken."""
    if trouble is not None:
        return Status("lost", f"{trouble}; trying again…")
    return Status("busy", "taking the untouched skin: do not touch it…")


def duration(ms: float) -> str:
    """A time span as a person says it."""
    return f"{ms:.0f} ms" if ms < 1000 else f"{ms / 1000:.1f} s" if ms < 60_000 else f"{ms / 60_000:.0f} min"

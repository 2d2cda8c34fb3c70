"""The untouched skin of a stretch of the session: how it looks, and what it weighs."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.capture.force_torque.tared import TareRefused, tare_of
from ninedtact.quantities import Frame, Wrench
from ninedtact.recording.collecting.settings import CollectSettings
from ninedtact.recording.collecting.skin_seen import SkinSeen

LEAVE_IT = "leave the skin untouched"
NO_SAMPLES = "no samples from the force/torque sensor yet"


@dataclass(frozen=True)
class Untouched:
    """What a tare found."""

    number: int
    frames: tuple[Frame, ...]
    zero: Float64[Array, "6"]
    """N and N·m about the skin's centre."""
    seen: SkinSeen

    def taken_off(self, wrench: Wrench) -> Wrench:
        """A wrench about the skin's centre without what nothing weighs."""
        force_n, torque_nm = (wrench.six - self.zero).reshape(2, 3)
        return Wrench(force_n, torque_nm, stamp_ns=wrench.stamp_ns)


@dataclass
class Taring:
    """Gathers images and samples until they are enough and still; begins anew when something moves."""

    number: int
    settings: CollectSettings
    last: Untouched | None = None
    """What the skin was before."""
    frames: list[Frame] = field(default_factory=list)
    wrenches: list[Wrench] = field(default_factory=list)
    advice: str = LEAVE_IT
    """For a person, while it goes on."""

    def see(self, frame: Frame) -> None:
        """An image; only as many as are wanted are kept."""
        self.frames.append(frame)
        del self.frames[: -self.settings.untouched_images]
        if not self.wrenches:
            self.advice = NO_SAMPLES

    def feel(self, wrench: Wrench) -> None:
        """A sample about the skin's centre."""
        self.wrenches.append(wrench)
        if self.advice == NO_SAMPLES:
            self.advice = LEAVE_IT

    @property
    def is_enough(self) -> bool:
        """Whether there are as many images, and samples for as long, as were asked for."""
        long_ns = self.wrenches[-1].stamp_ns - self.wrenches[0].stamp_ns if self.wrenches else 0
        return len(self.frames) >= self.settings.untouched_images and long_ns >= self.settings.tare.seconds * 1e9

    def untouched(self) -> Untouched | None:
        """What was found, when it is enough and still."""
        if not self.is_enough:
            return None
        try:
            found = self.found()
        except TareRefused as refusal:
            self.advice = str(refusal)
        else:
            self.advice = self.objection(found)
            if not self.advice:
                return found
        self.frames.clear()
        self.wrenches.clear()
        return None

    def found(self) -> Untouched:
        """The skin as it was gathered; raises `TareRefused`."""
        zero = tare_of(self.wrenches, self.settings.tare).mean
        return Untouched(self.number, tuple(self.frames), zero, SkinSeen([frame.image for frame in self.frames]))

    def objection(self, found: Untouched) -> str:
        """Why this cannot be untouched skin; empty when it can."""
        most = self.settings.touched_levels
        if any(found.seen.change(frame.image) > most for frame in found.frames):
            return f"{LEAVE_IT}: it moves"
        if self.last is None or self.last.seen.change(found.frames[-1].image) <= most:
            return ""
        weighs = (np.abs(found.zero - self.last.zero) > self.settings.rest).any()
        return f"{LEAVE_IT}: something presses on it" if weighs else ""

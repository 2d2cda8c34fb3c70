"""What a session asks of its sensor, and what it is told.

A session does not solve or draw. It asks for the next step of a hand, or for a look at the skin, and waits; `alone` answers
one session at once on the processor, `dataset.together` answers many in one batch on one device. So both make the same pairs
from the same session.
"""

from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, TypeVar

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Wrench
from ninedtact.simulation.rectified import GreyEye
from ninedtact.simulation.sensor_population import SampledSensor
from ninedtact.simulation.twin import Twin

Factor = Float32[Array, "rows cols"]
"""Brightness of every pixel relative to untouched skin."""


@dataclass(frozen=True, eq=False)
class Bench:
    """A simulated sensor that is ready for contact steps and renders. Instances compare by identity."""

    member: SampledSensor
    twin: Twin
    eye: GreyEye


@dataclass(frozen=True)
class Felt:
    """A contact as a hand feels it: in numbers, whichever array library the contact itself is in."""

    contact: Contact
    """As the model solved it: the next step goes on from it."""
    seen: Contact
    """As it is seen and weighed."""
    wrench: Wrench
    """Of what is weighed."""
    touches: bool
    deepest_mm: float
    """The largest indentation of the skin as it was solved."""
    area_mm2: float
    """Under pressure."""
    stiffer: float
    """How much heavier the contact is felt than the model solved it."""

    @property
    def pose(self) -> Pose:
        """Of the object, with the depth that was found."""
        return self.contact.pose


class Asked(ABC):
    """Something a session waits for."""

    @abstractmethod
    def alone(self) -> Any:
        """The answer, by the processor; raises what refuses it."""


@dataclass(frozen=True)
class Step(Asked):
    """An object moves on to a pose, or to a load near it; the answer is `Felt`."""

    bench: Bench
    last: Contact | None
    """None: untouched skin."""
    indenter: Indenter
    pose: Pose
    load_n: float | None = None
    widely: bool = False
    """On the whole patch: `dataset.together` found its window too small, and asks again. Alone it finds that out by itself."""

    def alone(self) -> Felt:
        """Raises what `Twin.step` raises."""
        twin = self.bench.twin
        last = twin.model.untouched() if self.last is None else self.last
        contact = twin.step(last, self.indenter, self.pose, self.load_n)
        return felt(contact, twin.correct_contact(contact))


@dataclass(frozen=True)
class Look(Asked):
    """What the sensor shows; the answer is a `Factor`, or None for untouched skin."""

    bench: Bench
    seen: Contact | None
    """None: nothing touches."""

    def alone(self) -> Factor | None:
        """As OpenCV draws it."""
        return self.bench.eye.factor(self.seen)


Result = TypeVar("Result")
Asking = Generator[Asked, Any, Result]
"""Asks, is sent the answers, or has refusals thrown at it, and returns in the end."""


def alone(asking: Asking[Result]) -> Result:
    """What comes of it when every question is answered at once, by the processor."""
    try:
        asked = next(asking)
        while True:
            asked = told(asking, answer_of(asked))
    except StopIteration as end:
        return end.value


def answer_of(asked: Asked) -> Any:
    """The processor's, a refusal included."""
    try:
        return asked.alone()
    except NinedtactError as refusal:
        return refusal


def told(asking: Asking[Any], answer: Any) -> Asked:
    """Hand over an answer, or a refusal, and hear what is asked next; raises `StopIteration` when it is over."""
    return asking.throw(answer) if isinstance(answer, NinedtactError) else asking.send(answer)


def felt(contact: Contact, seen: Contact) -> Felt:
    """One contact in NumPy arrays, in numbers."""
    area = float((contact.pressure_mpa > 0).sum()) * contact.skin.patch.cell_mm2
    stiffer = float(seen.pressure_mpa.sum() / contact.pressure_mpa.sum()) if contact.touches else 1.0
    return Felt(contact, seen, seen.wrench(), contact.touches, -float(np.min(contact.height_mm)), area, stiffer)

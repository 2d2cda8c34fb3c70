"""Requests of a session to its simulated sensor, and their computation one by one on the processor.

A session is a generator. It neither solves contacts nor renders: it yields a request for the next contact step or for an image,
and receives the response. `run_session_on_cpu` responds to one session; `executor.BatchExecutor` responds to many sessions in
batches on one device. The same session therefore makes the same pairs of image and wrench in both ways.
"""

from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from jaxtyping import Float32, Float64
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.array_namespace import array_namespace_of, to_numpy
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.shrinking_batch import sum_over_grid
from ninedtact.quantities import Wrench
from ninedtact.simulation.twin import Twin
from ninedtact_train.population.rectified_renderer import RectifiedRenderer
from ninedtact_train.population.sensor_population import SampledSensor

BrightnessFactor = Float32[Array, "rows cols"]
"""Brightness of every pixel relative to the reference image (no contact)."""


@dataclass(frozen=True, eq=False)
class SimulatedSetup:
    """A simulated sensor that is ready for contact steps and images. Instances compare by identity."""

    member: SampledSensor
    twin: Twin
    renderer: RectifiedRenderer


@dataclass(frozen=True)
class ContactSummary:
    """A solved contact with its scalar summary, which does not depend on the array library of the contact."""

    contact: Contact
    """The contact as the model solved it; the next step starts from it."""
    corrected: Contact
    """The contact as it is rendered and measured: corrected where the sensor's mechanics are not linear."""
    wrench: Wrench
    """The wrench of the corrected contact."""
    touches: bool
    max_indentation_mm: float
    """The maximum indentation of the skin as it was solved."""
    contact_area_mm2: float
    """The area under pressure."""
    stiffening: float
    """Ratio of the corrected load to the solved load."""

    @property
    def pose(self) -> Pose:
        """The pose of the object, with the depth that was found."""
        return self.contact.pose


class SessionRequest(ABC):
    """One request of a session, which waits for its response."""

    @abstractmethod
    def respond(self) -> Any:
        """Return the response, computed on the processor; raises the error that refuses the request."""


@dataclass(frozen=True)
class StepRequest(SessionRequest):
    """A move of an object to a pose, or to a load of the linear layer near it; the response is a `ContactSummary`."""

    setup: SimulatedSetup
    last: Contact | None
    """The last contact; None before the first."""
    indenter: Indenter
    pose: Pose
    load_n: float | None = None
    on_whole_grid: bool = False
    """Whether to solve on the whole grid. A batch sets it where it found the region of this contact too small; on the processor
    this happens within the step.
    """

    def respond(self) -> ContactSummary:
        """Return the contact; raises what `Twin.step` raises."""
        twin = self.setup.twin
        last = twin.model.initial_contact() if self.last is None else self.last
        contact = twin.step_linear_layer(last, self.indenter, self.pose, self.load_n)
        corrected = twin.correct_contact(contact)
        return _contact_summary(contact, corrected, corrected.wrench(), _summary_numbers(contact, corrected))


@dataclass(frozen=True)
class RenderRequest(SessionRequest):
    """An image of the sensor; the response is a `BrightnessFactor`, or None without contact."""

    setup: SimulatedSetup
    contact: Contact | None
    """The contact as it is rendered; None where nothing touches."""

    def respond(self) -> BrightnessFactor | None:
        """Return the brightness factor, rendered with OpenCV."""
        return self.setup.renderer.brightness_factor(self.contact)


Result = TypeVar("Result")
RequestGenerator = Generator[SessionRequest, Any, Result]
"""A generator that yields requests, receives their responses or has refusals thrown into it, and returns a result."""


def run_session_on_cpu(requests: RequestGenerator[Result]) -> Result:
    """Return the result of a session whose requests are computed one by one on the processor."""
    try:
        request = next(requests)
        while True:
            request = send_to_session(requests, respond_on_cpu(request))
    except StopIteration as end:
        return end.value


def respond_on_cpu(request: SessionRequest) -> Any:
    """Return the response computed on the processor; a refusal is returned rather than raised."""
    try:
        return request.respond()
    except NinedtactError as refusal:
        return refusal


def send_to_session(requests: RequestGenerator[Any], response: Any) -> SessionRequest:
    """Send a response to a session, or throw a refusal into it, and return its next request.

    Raises `StopIteration` where the session has ended.
    """
    return requests.throw(response) if isinstance(response, NinedtactError) else requests.send(response)


def summarize_contacts(contacts: Contact, corrected: Contact) -> list[ContactSummary]:
    """Return the summary of each contact of a batch; all are of one sensor."""
    numbers, wrenches = _summary_numbers(contacts, corrected), corrected.wrenches()
    wrench_of = (Wrench(six[:3], six[3:]) for six in wrenches)
    each = zip(contacts.unstack(), corrected.unstack(), wrench_of, numbers, strict=True)
    return [_contact_summary(*one) for one in each]


def _contact_summary(
    contact: Contact, corrected: Contact, wrench: Wrench, numbers: Float64[Array, "3"]
) -> ContactSummary:
    """Return a summary with the numbers of `_summary_numbers`."""
    points, max_indentation_mm, stiffening = numbers.tolist()
    area = points * contact.skin.grid.cell_area_mm2
    return ContactSummary(contact, corrected, wrench, points > 0, max_indentation_mm, area, stiffening)


def _summary_numbers(contacts: Contact, corrected: Contact) -> Float64[Array, "*batch 3"]:
    """Return the number of points under pressure, the largest indentation and the stiffening, of one contact or each of a batch."""
    xp, pressed = array_namespace_of(contacts.height_mm), contacts.pressure_mpa > 0
    solved = sum_over_grid(contacts.pressure_mpa)
    ratio = sum_over_grid(corrected.pressure_mpa) / xp.where(solved > 0, solved, 1.0)
    stiffening = xp.where(solved > 0, ratio, 1.0)
    deepest = -xp.min(contacts.height_mm, axis=(-2, -1), keepdims=True)
    every = (xp.astype(sum_over_grid(pressed), deepest.dtype), deepest, stiffening)
    return to_numpy(xp.concat(every, axis=-1))[..., 0, :]

"""Requests of a session to its simulated sensor, and their computation one by one on the processor.

A session is a generator. It neither solves contacts nor renders: it yields a request for the next contact step or for an image,
and receives the response. `run_session_on_cpu` responds to one session; `executor.BatchExecutor` responds to many sessions in
batches on one device. The same session therefore makes the same pairs of image and wrench in both ways.
"""

from abc import ABC, abstractmethod
from collections.abc import Generator
from dataclasses import dataclass
from typing import Any, TypeVar

from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.twin import Press, Twin
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


class SessionRequest(ABC):
    """One request of a session, which waits for its response."""

    @abstractmethod
    def respond(self) -> Any:
        """Return the response, computed on the processor; raises the error that refuses the request."""


@dataclass(frozen=True)
class StepRequest(SessionRequest):
    """A move of an object to a pose, or to a load of the linear layer near it; the response is a `Press`."""

    setup: SimulatedSetup
    last: Press | None
    """The last press; None before the first."""
    indenter: Indenter
    pose: Pose
    load_n: float | None = None
    on_whole_grid: bool = False
    """Whether to solve on the whole grid. A batch sets it where it found the region of this contact too small; on the processor
    this happens within the step.
    """

    def respond(self) -> Press:
        """Return the press; raises what `Twin.press` raises."""
        return self.setup.twin.press(self.last, self.indenter, self.pose, self.load_n, is_linear_load=True)


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

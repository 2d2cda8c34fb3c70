"""Requests of a session to its simulated sensor, their computation one by one on the processor, and the choice of another device.

A session is a generator. It neither solves contacts nor renders: it yields a request for the next contact step or for an image,
and receives the response. `run_session_on_cpu` responds to one session; `executor.BatchExecutor` responds to many sessions in
batches on one device. The same session therefore makes the same pairs of image and wrench in both ways.
"""

from collections.abc import Generator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from sys import platform
from typing import Any, TypeVar

from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact._version import installation_command
from ninedtact.errors import DeviceError, NinedtactError
from ninedtact.mechanics.active_region import GridRectangle
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.cuda_graphs import forget_graphs
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import Twin
from ninedtact_train.population.sensor_population import RectifiedRenderer, SampledSensor

BrightnessFactor = Float32[Array, "rows cols"]
"""Brightness of every pixel relative to the reference image (no contact)."""


@dataclass(frozen=True, eq=False)
class SimulatedSetup:
    """A simulated sensor that is ready for contact steps and images. Instances compare by identity."""

    member: SampledSensor
    twin: Twin
    renderer: RectifiedRenderer


@dataclass(frozen=True)
class StepRequest:
    """A move of an object to a pose, or to a load of the linear layer near it; the response is a `Press`."""

    setup: SimulatedSetup
    last: Press | None
    """The last press; None before the first."""
    indenter: Indenter
    pose: Pose
    load_n: float | None = None
    rectangle: GridRectangle | None = None
    guess: Contact | None = None
    """Where to solve, and the first guess. A batch sets them where it found the region of this contact too small; on the processor
    this happens within the step.
    """

    def respond(self) -> Press:
        """Return the press; raises what `Twin.press` raises."""
        return self.setup.twin.press(self.last, self.indenter, self.pose, self.load_n, is_linear_load=True)


@dataclass(frozen=True)
class RenderRequest:
    """An image of the sensor; the response is a `BrightnessFactor`, or None without contact."""

    setup: SimulatedSetup
    contact: Contact | None
    """The contact as it is rendered; None where nothing touches."""

    def respond(self) -> BrightnessFactor | None:
        """Return the brightness factor, rendered with OpenCV."""
        return self.setup.renderer.brightness_factor(self.contact)


SessionRequest = StepRequest | RenderRequest
Result = TypeVar("Result")
RequestGenerator = Generator[SessionRequest, Any, Result]
"""A generator that yields requests, receives their responses or has refusals thrown into it, and returns a result."""


def run_session_on_cpu(requests: RequestGenerator[Result]) -> Result:
    """Return the result of a session whose requests are computed one by one on the processor."""
    response = None
    try:
        while True:
            response = respond_on_cpu(send_to_session(requests, response))
    except StopIteration as end:
        return end.value


def respond_on_cpu(request: SessionRequest) -> Any:
    """Return the response computed on the processor; a refusal is returned rather than raised."""
    try:
        return request.respond()
    except NinedtactError as refusal:
        return refusal


def send_to_session(requests: RequestGenerator[Any], response: Any) -> SessionRequest:
    """Send a response to a session, None to start it, or throw a refusal into it; return its next request.

    Raises `StopIteration` where the session has ended.
    """
    return requests.throw(response) if isinstance(response, NinedtactError) else requests.send(response)


_DRIVER_FILES = ("/dev/nvidiactl", "/dev/kfd", "/dev/dxg")
"""Files of GPU drivers (NVIDIA, AMD, and either under WSL). Only where one exists is torch, which takes seconds to load,
queried."""
_DEVICE_NAMES = "auto, cpu, cuda, cuda:N or torch-cpu"
_OUT_OF_MEMORY_WORDS = ("out of memory", "CUFFT_ALLOC_FAILED", "CUFFT_INTERNAL_ERROR")
"""Words in the error messages of torch and of cuFFT when memory runs out."""


@dataclass(frozen=True)
class Device:
    """Where contacts are solved and images are rendered."""

    name: str

    @property
    def kind(self) -> str:
        """The kind `cpu`, `torch-cpu` or `cuda`: kinds round differently, so a data set is made by one kind."""
        return self.name.partition(":")[0]

    @property
    def is_batched(self) -> bool:
        """Whether sessions advance together in batches."""
        return self.kind != "cpu"

    def zero_array(self) -> Any:
        """Return a torch zero on the device in single precision; raises `DeviceError` where its memory is full."""
        import torch

        try:
            return torch.zeros((), dtype=torch.float32, device="cpu" if self.kind == "torch-cpu" else self.name)
        except RuntimeError as error:
            if not is_out_of_memory(error):
                raise
            raise DeviceError(
                expected=f"room in the memory of {self.name}",
                got="none at all",
                remedy="end other programs that use it, or give --device cpu",
            ) from error

    def release_memory(self) -> None:
        """Release the memory that torch keeps for later use."""
        if self.kind == "cuda":
            import torch

            forget_graphs()
            torch.cuda.empty_cache()


def choose_compute_device(name: str) -> Device:
    """Return the device of this name; `auto` is a GPU where torch finds one, else the processor. Raises `DeviceError`."""
    kind, _, number = name.partition(":")
    if name == "auto":
        return Device("cuda" if _gpu_driver_exists() and find_spec("torch") and _gpu_count() else "cpu")
    if name == "cpu":
        return Device(name)
    if not (name in ("cuda", "torch-cpu") or (kind == "cuda" and number.isdecimal())):
        raise DeviceError(expected=f"a device named {_DEVICE_NAMES}", got=f"{name!r}", remedy="correct it")
    if find_spec("torch") is None:
        raise DeviceError(
            expected=f"torch, which computes on {name}",
            got="no such package",
            remedy=f"run {installation_command('train')}, or give --device cpu",
        )
    if kind == "cuda" and int(number or 0) >= (count := _gpu_count()):
        raise DeviceError(
            expected=f"{name}, a GPU that torch sees",
            got=f"{count}, cuda:0 to cuda:{count - 1}" if count else "none",
            remedy="give --device cpu, or a torch that is built for the GPU and its driver",
        )
    return Device(name)


def is_out_of_memory(error: RuntimeError) -> bool:
    """Return whether this error says that the device's memory is full."""
    import torch

    return isinstance(error, torch.OutOfMemoryError) or any(word in str(error) for word in _OUT_OF_MEMORY_WORDS)


def _gpu_driver_exists() -> bool:
    """Return whether a GPU may be there, so that loading torch is worthwhile."""
    return platform == "win32" or any(Path(driver).exists() for driver in _DRIVER_FILES)


def _gpu_count() -> int:
    import torch

    return torch.cuda.device_count() if torch.cuda.is_available() else 0

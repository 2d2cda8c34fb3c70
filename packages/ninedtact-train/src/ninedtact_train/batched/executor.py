"""Sessions that advance together: their requests are collected in batches and computed on one device, which is the processor (one
contact at a time) or a torch device (many contacts at once).

All pending renders are computed in one batch, then all pending contact steps. Batches become smaller when the device's memory runs
out. Which sessions advance together is fixed in advance, and sessions do not affect each other, so their results do not depend
on the order of responses.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.util import find_spec
from pathlib import Path
from sys import platform
from typing import Any, Protocol, runtime_checkable

import numpy as np
from array_api_compat import to_device

from ninedtact._version import installation_command
from ninedtact.errors import DeviceError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.height_grid_indenter import DeviceHeightGrids
from ninedtact.simulation.renderer import BatchRenderer
from ninedtact_train.batched.contact_batch import ContactBatch, SkinStack, StepResponse, refusal_before_solving
from ninedtact_train.batched.session_requests import (
    BrightnessFactor,
    RenderRequest,
    RequestGenerator,
    SessionRequest,
    SimulatedSetup,
    StepRequest,
    send_to_session,
)

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
            if not _is_out_of_memory(error):
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
    if kind == "cuda":
        _require_gpu(name, int(number or 0))
    return Device(name)


def _is_out_of_memory(error: RuntimeError) -> bool:
    """Return whether this error says that the device's memory is full."""
    import torch

    return isinstance(error, torch.OutOfMemoryError) or any(word in str(error) for word in _OUT_OF_MEMORY_WORDS)


def _require_gpu(name: str, number: int) -> None:
    """Refuse a GPU that torch does not find; raises `DeviceError`."""
    count = _gpu_count()
    if number >= count:
        found = f"{count}, cuda:0 to cuda:{count - 1}" if count else "none"
        raise DeviceError(
            expected=f"{name}, a GPU that torch sees",
            got=f"{found}",
            remedy="give --device cpu, or a torch that is built for the GPU and its driver",
        )


def _gpu_driver_exists() -> bool:
    """Return whether a GPU may be there, so that loading torch is worthwhile."""
    return platform == "win32" or any(Path(driver).exists() for driver in _DRIVER_FILES)


def _gpu_count() -> int:
    """Return the number of GPUs that torch can use."""
    import torch

    return torch.cuda.device_count() if torch.cuda.is_available() else 0


@dataclass
class BatchExecutor:
    """Computes the requests to several simulated sensors in batches on one device."""

    sensor_numbers: Sequence[int]
    """Numbers of the sensors in the population."""
    setups: Sequence[SimulatedSetup]
    device: Device
    batch_size: int
    """Largest number of requests in one batch; halved when memory runs out."""
    report: Callable[[str], None]
    """Receives a message when memory runs out."""
    store: DeviceHeightGrids = field(init=False)
    stack: SkinStack = field(init=False)
    renderers: dict[SimulatedSetup, BatchRenderer] = field(default_factory=dict, init=False)
    memory_error: str = field(default="", init=False)
    """The message of torch when memory ran out."""

    def __post_init__(self) -> None:
        like = self.device.zero_array()
        self.store, self.stack = DeviceHeightGrids(like), SkinStack(self.setups, like)

    def setup(self, sensor_number: int) -> SimulatedSetup:
        """Return the simulated sensor of this number in the population."""
        return self.setups[self.sensor_numbers.index(sensor_number)]

    def execute(self, requests: Sequence[SessionRequest]) -> list[Any]:
        """Return the responses to requests that are all steps or all renders.

        A response that is itself a request must be computed in place of the first one. Raises `DeviceError`.
        """
        responses: list[Any] = []
        while len(responses) < len(requests):
            batch = requests[len(responses) :][: self.batch_size]
            found = self._execute_unless_memory_runs_out(batch)
            if found is None:
                self._halve_batch_size(len(batch))
            else:
                responses += found
        return responses

    def _execute_unless_memory_runs_out(self, requests: Sequence[SessionRequest]) -> list[Any] | None:
        """Return the responses, or None where memory ran out.

        The error is not passed on, because it keeps all arrays that led to it alive.
        """
        try:
            renders = [request for request in requests if isinstance(request, RenderRequest)]
            if renders:
                return self._render(renders)
            return self._solve([request for request in requests if isinstance(request, StepRequest)])
        except RuntimeError as error:
            if not _is_out_of_memory(error):
                raise
            self.memory_error = str(error).partition("\n")[0]
            return None

    def _halve_batch_size(self, failed: int) -> None:
        """Use smaller batches after one of this size failed; raises `DeviceError` after a batch of one."""
        if failed == 1:
            raise DeviceError(
                expected=f"room for one contact in the memory of {self.device.name}",
                got=f"{self.memory_error!r}",
                remedy="end other programs that use it, or give a coarser --pitch-mm, or --device cpu",
            )
        self.batch_size = failed // 2
        self.device.release_memory()
        self.report(
            f"the memory of {self.device.name} is too small for {failed} contacts at once; continuing with {failed // 2}"
        )

    def _solve(self, requests: Sequence[StepRequest]) -> list[StepResponse]:
        """Return the contact of each step, or its refusal."""
        refusals = [refusal_before_solving(request) for request in requests]
        valid = [request for request, refusal in zip(requests, refusals, strict=True) if refusal is None]
        solved = iter(ContactBatch(valid, self.stack, self.store).responses() if valid else [])
        return [next(solved) if refusal is None else refusal for refusal in refusals]

    def _render(self, requests: Sequence[RenderRequest]) -> list[BrightnessFactor | None]:
        """Return the brightness factors of each render, computed sensor by sensor; None without contact."""
        factors: list[BrightnessFactor | None] = [None] * len(requests)
        of_setup: dict[SimulatedSetup, list[int]] = defaultdict(list)
        for index, request in enumerate(requests):
            if request.contact is not None:
                of_setup[request.setup].append(index)
        for setup, indices in of_setup.items():
            contacts = Contact.stack([contact for k in indices if (contact := requests[k].contact) is not None])
            rendered = np.asarray(to_device(self._renderer(setup).brightness_factors(contacts), "cpu"), np.float32)
            for index, factor in zip(indices, rendered, strict=True):
                factors[index] = factor
        return factors

    def _renderer(self, setup: SimulatedSetup) -> BatchRenderer:
        """Return the batch renderer of this sensor, kept for the next call."""
        if setup not in self.renderers:
            self.renderers[setup] = BatchRenderer(setup.renderer.renderer, self.stack.like)
        return self.renderers[setup]


@runtime_checkable
class Session(Protocol):
    """A sequence of requests to simulated sensors, each of which waits for the response to the one before."""

    number: int

    def requests(self) -> RequestGenerator[Any]:
        """Yield requests and receive their responses."""
        ...


def run_sessions(sessions: Sequence[Session], executor: BatchExecutor, threads: int) -> Iterator[set[int]]:
    """Run all sessions to their ends; yield after each batch the numbers of those that are still running.

    threads: for the work of the sessions between two requests, such as noise and PNG.
    """
    with ThreadPoolExecutor(threads) as pool:
        runners = list(pool.map(_SessionRunner, sessions))
        while runners:
            batch = [runner for runner in runners if isinstance(runner.pending, RenderRequest)] or runners
            responses = executor.execute([runner.pending for runner in batch if runner.pending is not None])
            list(pool.map(_SessionRunner.resume, batch, responses))
            runners = [runner for runner in runners if runner.pending is not None]
            yield {runner.session.number for runner in runners}


@dataclass
class _SessionRunner:
    """A running session with its pending request."""

    session: Session
    requests: RequestGenerator[Any] = field(init=False)
    pending: SessionRequest | None = field(init=False)
    """The pending request; None when the session has ended."""

    def __post_init__(self) -> None:
        self.requests = self.session.requests()
        self.pending = next(self.requests, None)

    def resume(self, response: Any) -> None:
        """Send a response to the session and keep its next request; a response that is a request becomes the pending one."""
        if isinstance(response, SessionRequest):
            self.pending = response
            return
        try:
            self.pending = send_to_session(self.requests, response)
        except StopIteration:
            self.pending = None

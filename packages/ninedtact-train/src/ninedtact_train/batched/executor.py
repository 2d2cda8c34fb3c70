"""Sessions that advance together: their requests are collected in batches, each of which a torch device computes at once.

All pending renders are computed in one batch, then all pending contact steps. Batches become smaller when the device's memory runs
out. Which sessions advance together is fixed in advance, and sessions do not affect each other, so their results do not depend
on the order of responses.
"""

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from array_api_compat import to_device

from ninedtact.errors import DeviceError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.height_grid_indenter import DeviceHeightGrids
from ninedtact.simulation.renderer import BatchRenderer
from ninedtact_train.batched.contact_batch import ContactBatch, SkinStack, StepResponse, refusal_before_solving
from ninedtact_train.batched.session_requests import (
    BrightnessFactor,
    Device,
    RenderRequest,
    RequestGenerator,
    SessionRequest,
    SimulatedSetup,
    StepRequest,
    is_out_of_memory,
    send_to_session,
)

_SIZE_STEP = 32
"""Batches on a GPU are filled up to multiples of this size."""


@dataclass
class BatchExecutor:
    """Computes the requests to several simulated sensors in batches on one device."""

    setups: Mapping[int, SimulatedSetup]
    """The simulated sensors by their numbers in the population."""
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
        self.store, self.stack = DeviceHeightGrids(like), SkinStack([*self.setups.values()], like)

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
            if not is_out_of_memory(error):
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
        refusals = [refusal_before_solving(request) for request in requests]
        valid = [request for request, refusal in zip(requests, refusals, strict=True) if refusal is None]
        # Few sizes of batches, so that their rounds are recorded: the last request fills the batch up.
        filled = valid + valid[-1:] * (-len(valid) % _SIZE_STEP if self.device.kind == "cuda" else 0)
        solved = iter(ContactBatch(filled, self.stack, self.store).responses() if valid else [])
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
            if setup not in self.renderers:
                self.renderers[setup] = BatchRenderer(setup.renderer.renderer, self.stack.like)
            found = self.renderers[setup].brightness_factors(contacts)
            rendered = np.asarray(to_device(found, "cpu"), np.float32)
            for index, factor in zip(indices, rendered, strict=True):
                factors[index] = factor
        return factors


def run_sessions(
    sessions: Mapping[int, RequestGenerator[Any]], executor: BatchExecutor, threads: int
) -> Iterator[set[int]]:
    """Run the requests of all sessions to their ends; yield after each batch the numbers of those that are still running.

    sessions: requests by the number of the session. threads: for the work between two requests, such as noise and PNG.
    """
    with ThreadPoolExecutor(threads) as pool:
        runners = list(pool.map(_SessionRunner, sessions.keys(), sessions.values()))
        while runners:
            batch = [runner for runner in runners if isinstance(runner.pending, RenderRequest)] or runners
            responses = executor.execute([runner.pending for runner in batch if runner.pending is not None])
            list(pool.map(_SessionRunner.resume, batch, responses))
            runners = [runner for runner in runners if runner.pending is not None]
            yield {runner.number for runner in runners}


@dataclass
class _SessionRunner:
    number: int
    requests: RequestGenerator[Any]
    pending: SessionRequest | None = field(init=False)
    """The pending request; None when the session has ended."""

    def __post_init__(self) -> None:
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

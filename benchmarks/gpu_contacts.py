"""Contacts per second of a data set, solved and rendered, many at a time with torch on a GPU if there is one.

Sessions of `ninedtact simulate dataset` are advanced as `--device cuda` advances them: twenty sensors, generated objects, default
grid, images of 460 x 345; but every contact is rendered. Beside them one session without torch. Without a GPU torch does the same
on the CPU, which is slow and says nothing of a GPU; but its operations are counted, and the time that they would take a GPU is
computed from the bandwidth of its memory, and called extrapolated.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import tyro
from figures import Figure, answer, at_least

from ninedtact.simulation.twin import Press
from ninedtact_train.batched.executor import BatchExecutor, run_sessions
from ninedtact_train.batched.session_requests import (
    Device,
    RenderRequest,
    SessionRequest,
    SimulatedSetup,
    StepRequest,
    choose_compute_device,
    respond_on_cpu,
)
from ninedtact_train.collecting.training_pair_rule import PairKindShares, SamplingRuleSettings
from ninedtact_train.dataset.generation.generate import make_simulated_sensor
from ninedtact_train.dataset.generation.press_session import SimulatedPressSession
from ninedtact_train.dataset.generation.settings import GenerationSettings

WANTED_PER_S = 500.0
"""Rendered contacts on a GPU."""
ON_GPU, ON_CPU, AT_ONCE = (64, 256), (16, 64), 256
"""Numbers of sessions at once that are measured, and the one that `ninedtact simulate dataset` takes by default."""
SENSORS, WARM_UP = 20, 2
EVERY = SamplingRuleSettings(contact_below_n=-1e-9, first_below_n=(-1e-9, -1e-9), min_difference=1e-9)
"""Every contact is kept."""
BANDWIDTH = {"H200": 4.8e12, "A100 80 GB": 2.0e12, "RTX 4090": 1.0e12}
"""Of a GPU's memory, bytes per second, as their makers state."""
REACHED, LAUNCH_S = 0.6, 8e-6
"""Assumed: the share of it that plain operations on large arrays reach, and the time to start one operation from Python, with no
overlap of the two."""
VIEWS = {"view", "_unsafe_view", "slice", "select", "unsqueeze", "squeeze", "expand", "permute", "transpose", "alias"}
"""Operations of torch that touch no memory."""

Execute = Callable[[Sequence[SessionRequest]], list[Any]]


def gpu_contacts(
    device: str = "auto",
    at_once: tuple[int, ...] = (),
    batches: int = 3,
    threads: int = 1,
    quick: bool = False,
    json: bool = False,
) -> None:
    """Measure. device: as `ninedtact simulate dataset` takes it. batches: timed ones. threads: for motion, noise and PNG."""
    at_once, batches, alone = ((2,), 1, 1) if quick else (at_once, batches, 40)
    figures = list(
        run(lambda setups: respond_one_by_one, 1, alone, 1, quick).figures("one at a time, CPU without torch")
    )
    if find_spec("torch") is None:
        figures.append(Figure("many at a time", "not measured: torch is not installed; pip install 'ninedtact[train]'"))
    else:
        figures += torch_figures(choose_compute_device(device), at_once, batches, threads, quick)
    answer("Contacts per second of a data set, each rendered", figures, json)


def torch_figures(
    device: Device, at_once: tuple[int, ...], batches: int, threads: int, quick: bool
) -> Iterator[Figure]:
    """Yield the figures of batches on one device."""
    import torch

    gpu = device.kind == "cuda"
    device = device if gpu else Device("torch-cpu")
    torch.set_num_threads(1)
    name = torch.cuda.get_device_name(device.name) if gpu else "CPU, 1 thread; no GPU here, these are no figures of one"
    yield Figure("device", f"{name}; torch {torch.__version__}")
    for many in at_once or (ON_GPU if gpu else ON_CPU):

        def execute_on(setups: Sequence[SimulatedSetup], many: int = many) -> Execute:
            return BatchExecutor(dict(enumerate(setups)), device, many, print).execute

        yield from run(execute_on, many, batches, threads, quick).figures(f"{many} at a time", gpu)
    if not gpu:
        yield from extrapolated(execute_on, many, quick)


def respond_one_by_one(requests: Sequence[SessionRequest]) -> list[Any]:
    return [respond_on_cpu(one) for one in requests]


@dataclass
class Clock:
    """An executor that times another."""

    method: Execute
    seconds: Counter[type] = field(default_factory=Counter)
    done: Counter[type] = field(default_factory=Counter)
    """Steps that came to a contact, and renderings."""
    batches: int = 0
    """Of steps."""
    others_s: float = 0.0
    """Motion, noise and PNG."""

    def execute(self, requests: Sequence[SessionRequest]) -> list[Any]:
        kind, start = type(requests[0]), perf_counter()
        responses = self.method(requests)
        self.seconds[kind] += perf_counter() - start
        self.done[kind] += sum(kind is RenderRequest or isinstance(one, Press) for one in responses)
        self.batches += kind is StepRequest
        return responses

    def figures(self, name: str, required: bool = False) -> Iterator[Figure]:
        """Yield contacts per second: solved; solved and rendered; with all else that a data set needs."""
        step_s, render_s = (self.seconds[kind] / max(1, self.done[kind]) for kind in (StepRequest, RenderRequest))
        yield Figure(f"{name}, solved per s", 1 / step_s)
        both, per_s = f"{name}, solved and rendered per s", 1 / (step_s + render_s)
        yield at_least(both, per_s, WANTED_PER_S, "per s") if required else Figure(both, per_s)
        all_s = step_s + render_s + self.others_s / max(1, self.done[StepRequest])
        yield Figure(f"{name}, with motion, noise and PNG per s", 1 / all_s)


def run(make: Callable[[list[SimulatedSetup]], Execute], many: int, batches: int, threads: int, quick: bool) -> Clock:
    """Run some batches of this many sessions, after a few that do not count."""
    settings = GenerationSettings(
        1000 * many, sensors=min(SENSORS, many), session_pairs=1000, shares=PairKindShares(0, 0), rule=EVERY
    )
    if quick:
        settings = replace(settings, pitch_mm=0.6, size=(64, 48), sensors=1)
    setups = [make_simulated_sensor(number, settings) for number in range(settings.sensors)]
    clock = Clock(make(setups))
    sessions = [SimulatedPressSession(number, settings, setups[number % len(setups)]) for number in range(many)]
    requests = {session.number: session.requests() for session in sessions}
    running = run_sessions(requests, clock, threads)  # type: ignore[arg-type]
    while clock.batches < WARM_UP:
        next(running)
    clock.seconds.clear(), clock.done.clear()
    start, clock.batches = perf_counter(), 0
    while clock.batches < batches or not clock.done[RenderRequest]:
        next(running)
    clock.others_s = perf_counter() - start - sum(clock.seconds.values())
    return clock


def extrapolated(make: Callable[[list[SimulatedSetup]], Execute], many: int, quick: bool) -> Iterator[Figure]:
    """Yield what the counted operations of one batch would take on a GPU. Bytes grow with the batch, operations hardly do."""
    counts: dict[type, tuple[Counter[str], int]] = {}

    def counting(setups: list[SimulatedSetup]) -> Execute:
        execute = make(setups)

        def count(requests: Sequence[SessionRequest]) -> list[Any]:
            with counted_operations() as counter:
                responses = execute(requests)
            counts[type(requests[0])] = counter.count, len(requests)
            return responses

        return count

    run(counting, many, 1, 1, quick)
    (step, steps), (look, looks) = counts[StepRequest], counts[RenderRequest]
    grid_points = make_simulated_sensor(0, GenerationSettings()).twin.model.skin.grid.positions_mm[0].size
    bytes_each = step["bytes"] / steps + look["bytes"] / looks
    operations = step["operations"] + look["operations"]
    yield Figure("operations of one batch, solved and rendered", operations)
    yield Figure("transforms there and back of the grid, per contact solved", step["transformed"] / grid_points / steps)
    yield Figure("read and written per contact, solved and rendered, GB", bytes_each / 1e9)
    for name, bandwidth in BANDWIDTH.items():
        contact_s = bytes_each / (REACHED * bandwidth) + operations * LAUNCH_S / AT_ONCE
        how = f"{REACHED:.0%} of {bandwidth / 1e12:g} TB/s, then {1e6 * LAUNCH_S:g} µs for each operation"
        yield Figure(f"EXTRAPOLATED, not measured: {name}, {AT_ONCE} at a time, per s", 1 / contact_s, peer=how)


def counted_operations() -> Any:
    """Return a context in which the operations of torch, and the bytes that they read and write, are counted."""
    from torch.utils._python_dispatch import TorchDispatchMode

    class Counting(TorchDispatchMode):
        def __init__(self) -> None:
            super().__init__()
            self.count: Counter[str] = Counter()

        def __torch_dispatch__(self, operation: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
            found, name = operation(*args, **(kwargs or {})), operation.overloadpacket.__name__
            if name not in VIEWS:
                self.count["operations"] += 1
                self.count["bytes"] += size_bytes(args) + size_bytes(found)
            if name == "_fft_c2r":
                self.count["transformed"] += found.numel()
            return found

    return Counting()


def size_bytes(values: Any) -> int:
    """Return the size of all arrays among values."""
    if isinstance(values, (list, tuple)):
        return sum(map(size_bytes, values))
    return values.numel() * values.element_size() if hasattr(values, "element_size") else 0


if __name__ == "__main__":
    tyro.cli(gpu_contacts)

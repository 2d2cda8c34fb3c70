"""Contacts per second of a data set, solved and drawn, many at a time with torch on a GPU if there is one.

Sessions of `ninedtact simulate dataset` are advanced as `--device cuda` advances them: twenty sensors, generated objects, default
grid, images of 460 x 345; but every contact is drawn. Beside them one session in the processor's own way. Without a GPU
torch does the same on the CPU, which is slow and says nothing of a GPU; but its operations are counted, and the time that
they would take a GPU is worked out from what its memory can carry, and called extrapolated.
"""

from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import tyro
from figures import Figure, answer, at_least
from tallied import Tally

from ninedtact.simulation.twin import Press
from ninedtact_train.batched.executor import BatchExecutor, Device, choose_compute_device, run_sessions
from ninedtact_train.batched.session_requests import (
    RenderRequest,
    SessionRequest,
    SimulatedSetup,
    StepRequest,
    respond_on_cpu,
)
from ninedtact_train.collecting.training_pair_rule import SamplingRuleSettings
from ninedtact_train.dataset.generation.generate import SimulatedPressSession, make_simulated_sensor
from ninedtact_train.dataset.generation.settings import GenerationSettings, PairKindShares

WANTED_PER_S = 500.0
"""Of drawn contacts, on a GPU."""
ON_GPU, ON_CPU, AT_ONCE = (64, 256), (16, 64), 256
"""Sessions at once that are measured, and that `ninedtact simulate dataset` takes by default."""
SENSORS, WARM_UP = 20, 2
EVERY = SamplingRuleSettings(contact_below_n=-1e-9, first_below_n=(-1e-9, -1e-9), min_difference=1e-9)
"""Every contact is worth keeping."""
BANDWIDTH = {"H200": 4.8e12, "A100 80 GB": 2.0e12, "RTX 4090": 1.0e12}
"""Of a GPU's memory, bytes per second, as their makers say."""
REACHED, LAUNCH_S = 0.6, 8e-6
"""Assumed: the part of it that plain operations on large arrays reach, and the time to ask for one operation from Python, with
no overlap of the two."""

Way = Callable[[Sequence[SessionRequest]], list[Any]]


def gpu_contacts(
    device: str = "auto", at_once: tuple[int, ...] = (), batches: int = 3, threads: int = 1, json: bool = False
) -> None:
    """Measure; device: as `ninedtact simulate dataset` takes it; batches: timed ones; threads: for hands, noise and PNG."""
    figures = list(run(lambda benches: one_by_one, 1, 40, 1).specification("one at a time, processor"))
    if find_spec("torch") is None:
        figures.append(Figure("many at a time", "not measured: torch is not installed; pip install 'ninedtact[train]'"))
    else:
        figures += torch_figures(choose_compute_device(device), at_once, batches, threads)
    answer("Contacts per second of a data set, each drawn", figures, json)


def torch_figures(device: Device, at_once: tuple[int, ...], batches: int, threads: int) -> Iterator[Figure]:
    """Batches on one device."""
    import torch

    gpu = device.kind == "cuda"
    on = device if gpu else Device("torch-cpu")
    torch.set_num_threads(1)
    name = (
        torch.cuda.get_device_name(device.name)
        if gpu
        else "CPU, 1 thread; no GPU here, and these are no figures of one"
    )
    yield Figure("device", f"{name}; torch {torch.__version__}")
    for many in at_once or (ON_GPU if gpu else ON_CPU):
        clock = run(lambda benches, many=many: room(benches, on, many).execute, many, batches, threads)
        yield from clock.specification(f"{many} at a time", gpu)
    if not gpu:
        yield from extrapolated(on, max(at_once or ON_CPU))


def one_by_one(asked: Sequence[SessionRequest]) -> list[Any]:
    return [respond_on_cpu(one) for one in asked]


def room(benches: Sequence[SimulatedSetup], device: Device, many: int) -> BatchExecutor:
    return BatchExecutor(range(len(benches)), benches, device, many, print)


@dataclass
class Clock:
    """Passes questions on and keeps time."""

    way: Way
    seconds: Counter[type] = field(default_factory=Counter)
    answered: Counter[type] = field(default_factory=Counter)
    """Steps that came to a contact, and looks."""
    batches: int = 0
    """Of steps."""
    others_s: float = 0.0
    """Hands, noise and PNG."""

    def answers(self, asked: Sequence[SessionRequest]) -> list[Any]:
        kind, start = type(asked[0]), perf_counter()
        told = self.method(asked)
        self.seconds[kind] += perf_counter() - start
        self.answered[kind] += sum(kind is RenderRequest or isinstance(one, Press) for one in told)
        self.batches += kind is StepRequest
        return told

    def each_s(self, kind: type) -> float:
        return self.seconds[kind] / max(1, self.answered[kind])

    def specification(self, name: str, judged: bool = False) -> Iterator[Figure]:
        """Per second: solved; solved and drawn; with all else that a data set needs."""
        drawn_s = self.each_s(StepRequest) + self.each_s(RenderRequest)
        yield Figure(f"{name}, solved per s", 1 / self.each_s(StepRequest))
        drawn = f"{name}, solved and drawn per s"
        yield at_least(drawn, 1 / drawn_s, WANTED_PER_S, "per s") if judged else Figure(drawn, 1 / drawn_s)
        yield Figure(
            f"{name}, with hands, noise and PNG per s", 1 / (drawn_s + self.others_s / self.answered[StepRequest])
        )


def run(way_of: Callable[[list[SimulatedSetup]], Way], many: int, batches: int, threads: int) -> Clock:
    """Some batches of this many sessions, after a few that do not count."""
    settings = GenerationSettings(
        1000 * many, sensors=min(SENSORS, many), session_pairs=1000, shares=PairKindShares(0, 0), rule=EVERY
    )
    benches = [make_simulated_sensor(number, settings) for number in range(settings.sensors)]
    clock = Clock(way_of(benches))
    sessions = [SimulatedPressSession(number, settings, benches[number % len(benches)]) for number in range(many)]
    going = run_sessions(sessions, clock, threads)  # type: ignore[arg-type]
    while clock.batches < WARM_UP:
        next(going)
    clock.seconds.clear(), clock.answered.clear()
    start, clock.batches = perf_counter(), 0
    while clock.batches < batches:
        next(going)
    clock.others_s = perf_counter() - start - sum(clock.seconds.values())
    return clock


def extrapolated(device: Device, many: int) -> Iterator[Figure]:
    """What the operations of one batch, counted, would take on a GPU. Bytes grow with the batch, operations hardly do."""
    tally = Tally()
    run(lambda benches: tally.of(room(benches, device, many).execute), many, 1, 1)
    step, look = tally.last(StepRequest), tally.last(RenderRequest)
    patch_points = make_simulated_sensor(0, GenerationSettings()).twin.model.skin.grid.positions_mm[0].size
    bytes_each = step.bytes / step.execute + look.bytes / look.execute
    operations = step.operations + look.operations
    yield Figure("operations of one batch, solved and drawn", operations)
    yield Figure(
        "transforms there and back of the patch, per contact solved", step.points / patch_points / step.execute
    )
    yield Figure("read and written per contact, solved and drawn, GB", bytes_each / 1e9)
    for name, bandwidth in BANDWIDTH.items():
        contact_s = bytes_each / (REACHED * bandwidth) + operations * LAUNCH_S / AT_ONCE
        how = f"{REACHED:.0%} of {bandwidth / 1e12:g} TB/s, then {1e6 * LAUNCH_S:g} µs for each operation"
        yield Figure(f"EXTRAPOLATED, not measured: {name}, {AT_ONCE} at a time, per s", 1 / contact_s, peer=how)


if __name__ == "__main__":
    tyro.cli(gpu_contacts)

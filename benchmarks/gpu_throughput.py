"""Environments per second on a GPU: contacts with friction's memory and their wrenches, alone and with images, all on the device.

A ball is pressed, dragged, twisted and tilted in every environment of a `TwinBatch`, each in its own way, on the gel of a simulated
sensor at finite strain on a base that yields. Beside the rates: how far the batch is from the CPU's presses, a coarser grid from
the finest, and the force from itself a thousand steps before; and sessions of `ninedtact simulate dataset`, which are of many
sensors and objects. Without a GPU, torch does the same on the CPU, whose rates say nothing of a GPU; what the step asks of one is
counted on any device: kernels, times at which the processor waits for the device, and bytes that kernels read and write, with the
rate that these bytes allow an H100. The whole fits into eight minutes; what does not is said not to be measured.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from time import perf_counter
from typing import Any, ClassVar

import cv2
import numpy as np
import torch
import tyro
from figures import Figure, answer, at_least, at_most, shown
from jaxtyping import Float64
from numpy import ndarray as Array
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

from ninedtact.calibration.nominal_shape import nominal_shape
from ninedtact.errors import DeviceError
from ninedtact.force.estimator_and_scale import MODULUS_KNOWN, ScaledForceEstimator
from ninedtact.force.traction.estimator import build_traction_force
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.mechanics.contact_model import SolverSettings
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin_batch import TwinBatch
from ninedtact_train.batched.depth_reading import BatchedDepthReader
from ninedtact_train.batched.executor import BatchExecutor, run_sessions
from ninedtact_train.batched.force_by_physics import BatchedPhysics
from ninedtact_train.batched.session_requests import (
    Device,
    RenderRequest,
    SimulatedSetup,
    StepRequest,
    choose_compute_device,
    is_out_of_memory,
)
from ninedtact_train.collecting.training_pair_rule import PairKindShares, SamplingRuleSettings
from ninedtact_train.dataset.generation.generate import make_simulated_sensor
from ninedtact_train.dataset.generation.press_session import SimulatedPressSession
from ninedtact_train.dataset.generation.settings import GenerationSettings

ENVIRONMENTS, PITCHES_MM = (64, 256, 1024, 4096, 16384), (0.2, 0.3, 0.4)
SIZES = {"60x80": (80, 60), "120x160": (160, 120), "172x230": (230, 172), "345x460": (460, 345)}
"""Sizes of images as (cols, rows)."""
REQUIRED_OF, ESTIMATES_REQUIRED = 4096, 2_000.0
REQUIRED = {(REQUIRED_OF, 0.4, "120x160"): 10_000.0, (REQUIRED_OF, 0.2, "345x460"): 5_000.0}
SESSIONS_REQUIRED = 500.0
H100_BYTES_PER_S = 3.35e12
"""Memory bandwidth of an H100 SXM (NVIDIA's data sheet)."""
COUNTED = 16
"""Environments of the counted steps."""
WARM_UP, WRENCH_SHARE, IMAGE_GREY = 6, 0.01, 0.1
"""Steps that do not count; and the largest differences from the CPU's press: wrench by load, and RMS of the image."""
ROUND = 60
"""Steps of the motion until it repeats itself."""
EVERY = SamplingRuleSettings(contact_below_n=-1e-9, first_below_n=(-1e-9, -1e-9), min_difference=1e-9)


def gpu_throughput(
    device: str = "auto",
    environments: tuple[int, ...] = ENVIRONMENTS,
    pitches_mm: tuple[float, ...] = PITCHES_MM,
    sizes: tuple[str, ...] = tuple(SIZES),
    seconds: float = 1.5,
    sessions: int = 256,
    minutes: float = 8.0,
    quick: bool = False,
    json: bool = False,
) -> None:
    """Measure. device: as `ninedtact simulate dataset` takes it. seconds: of one row. minutes: after which no part begins."""
    started = perf_counter()
    chosen = choose_compute_device(device)
    chosen = chosen if chosen.kind == "cuda" else Device("torch-cpu")
    if quick:
        environments, pitches_mm, sizes, seconds, sessions = (2,), (0.6, 0.8), ("120x160",), 0.0, 2
    torch.set_num_threads(1)
    gpu = chosen.kind == "cuda"
    name = torch.cuda.get_device_name(chosen.name) if gpu else "CPU, 1 thread; no GPU here, these are no figures of one"
    figures = [Figure("device", f"{name}; torch {torch.__version__}")]
    parts = {
        "accuracy": accuracy(chosen, pitches_mm, 2 if quick else 16, 4 if quick else ROUND),
        "drift": drift(chosen, pitches_mm[-1], 2 if quick else COUNTED, 3 if quick else 18),
        **{f"counts, {pitch:g} mm": counts(chosen, pitch, sizes[-1]) for pitch in pitches_mm},
        "sessions of a data set": sessions_rate(chosen, sessions, quick),
        **{
            f"{many} environments, {pitch:g} mm": rates(chosen, many, pitch, sizes, seconds)
            for many in environments
            for pitch in pitches_mm
        },
    }
    for name, part in parts.items():
        if perf_counter() - started > 60 * minutes:
            part = [Figure(name, f"not measured: {minutes:g} minutes are over")]
        for figure in part:
            figures.append(figure)
            print(figure.figure, shown(figure.measured), shown(figure.peer), flush=True)
    answer("Environments per second, all on one device", figures, json)


@lru_cache
def setup_at(pitch_mm: float, size: str) -> SimulatedSetup:
    """Return the first simulated sensor whose gel is at finite strain on a base that yields."""
    settings = GenerationSettings(1, pitch_mm=pitch_mm, size=SIZES[size])
    number = next(number for number in range(99) if settings.sensor_parameters(number).kind == "layered")
    return make_simulated_sensor(number, settings)


def poses_at(step: int, many: int) -> Float64[Array, "batch 6"]:
    """Return the poses of all environments at a step: down, across in a circle with twist and tilt, and up again."""
    phase = 2 * np.pi * (step / ROUND + np.arange(many) * 0.618 % 1)
    turn = np.arange(many) * 2.4
    depth_mm = 0.55 - 0.65 * np.cos(phase)
    tilt = 0.04 * np.sin(phase)
    x_mm, y_mm = 1.5 * np.cos(turn + 0.5 * np.sin(phase)), 1.5 * np.sin(turn + 0.5 * np.sin(phase))
    return np.stack([x_mm, y_mm, depth_mm, 0.2 * np.sin(phase), tilt * np.cos(turn), tilt * np.sin(turn)], axis=1)


@dataclass
class Motion:
    """A batch and the step of its motion."""

    device: Device
    many: int
    pitch_mm: float
    size: str = "120x160"
    step: int = 0
    batch: TwinBatch = field(init=False)

    def __post_init__(self) -> None:
        setup = setup_at(self.pitch_mm, self.size)
        on = self.device.name if self.device.kind == "cuda" else "cpu"
        ball = indenter_from_name("ball:4")
        self.batch = TwinBatch(setup.twin, [ball] * self.many, on, setup.renderer.renderer)

    def next(self) -> Press:
        """Return the presses of the next step."""
        poses = torch.from_numpy(poses_at(self.step, self.many)).to(self.batch.device)
        self.step += 1
        press = self.batch.step(poses)
        press.corrected.wrenches()
        return press

    def wait(self) -> None:
        """Wait until the device has done all that it was given."""
        if self.device.kind == "cuda":
            torch.cuda.synchronize()


def rates(device: Device, many: int, pitch_mm: float, sizes: Sequence[str], seconds: float) -> Iterator[Figure]:
    """Yield the rates of one batch, and the memory that it takes of a GPU; why there are none where the device refuses."""
    name = f"{many} environments, {pitch_mm:g} mm"
    device.release_memory()
    try:
        yield from step_rates(Motion(device, many, pitch_mm, sizes[0]), name, sizes, seconds)
        if device.kind == "cuda":
            yield Figure(f"{name}: memory, GB", torch.cuda.max_memory_allocated() / 1e9)
            torch.cuda.reset_peak_memory_stats()
    except DeviceError as error:
        yield Figure(name, str(error))
    except RuntimeError as error:
        if not is_out_of_memory(error):
            raise
        yield Figure(name, "out of memory")


def step_rates(motion: Motion, name: str, sizes: Sequence[str], seconds: float) -> Iterator[Figure]:
    """Yield environment steps per second: contact and wrench alone, with an image of each size, and with what is read from it."""
    batch, many = motion.batch, motion.many
    on_gpu = motion.device.kind == "cuda"

    def per_s(what: str, step_s: float, took: str, required: float | None = None) -> Figure:
        each = f"{name}, with {what} per s"
        return (
            at_least(each, many / step_s, required, "per s")
            if required and on_gpu
            else Figure(each, many / step_s, took)
        )

    for _ in range(WARM_UP if seconds else 1):
        press = motion.next()
    contact_s, press = timed(motion, motion.next, seconds)
    refused = f"{1e3 * contact_s:.3g} ms, {int(batch.refused.sum())} refused"
    yield Figure(f"{name}: contact and wrench per s", many / contact_s, peer=refused)
    for size in sizes:
        vars(batch).pop("_renderer", None), vars(batch).pop("_reference", None)
        batch.renderer = setup_at(motion.pitch_mm, size).renderer.renderer
        images = batch.images(press)
        image_s, _ = timed(motion, lambda: batch.images(press), seconds / 3)
        required = REQUIRED.get((many, motion.pitch_mm, size))
        yield per_s(f"image {size}", contact_s + image_s, f"image {1e3 * image_s:.3g} ms", required)
    physics, seen_s = batched_physics(batch), contact_s + image_s
    for what, call in (("heights", physics.reader), ("heights and force", physics)):
        call(images)
        reading_s, _ = timed(motion, lambda call=call: call(images), seconds / 3)
        required = ESTIMATES_REQUIRED if what != "heights" and many >= REQUIRED_OF else None
        took = f"{what} {1e3 * reading_s:.3g} ms"
        yield per_s(f"image {size}, estimated {what}", seen_s + reading_s, took, required)


class DeviceWork(TorchDispatchMode):
    """Counts the kernels that torch starts, and the bytes of the tensors that each reads and writes."""

    WITHOUT_KERNEL: ClassVar = {
        "empty",
        "empty_like",
        "empty_strided",
        "new_empty",
        "_local_scalar_dense",
        "lift_fresh",
        "detach",
    }

    WAITING: ClassVar = {"_local_scalar_dense", "nonzero"}
    """Those whose result the processor needs before it goes on."""

    def __init__(self) -> None:
        super().__init__()
        self.kernels = self.bytes = self.scalars_read = 0

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        found, name = func(*args, **(kwargs or {})), func.overloadpacket.__name__
        self.scalars_read += name in self.WAITING
        if not func.is_view and name not in self.WITHOUT_KERNEL:
            self.kernels += 1
            tensors = (one for one in tree_leaves((args, kwargs, found)) if isinstance(one, torch.Tensor))
            self.bytes += sum(one.numel() * one.element_size() for one in tensors)
        return found


class HostReads(TorchFunctionMode):
    """Counts the tensors that are read as NumPy arrays, for each of which the processor waits on a device."""

    def __init__(self) -> None:
        super().__init__()
        self.count = 0

    def __torch_function__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        self.count += getattr(func, "__name__", "") in ("__array__", "numpy", "tolist", "cpu")
        return func(*args, **(kwargs or {}))


def counts(device: Device, pitch_mm: float, size: str) -> Iterator[Figure]:
    """Yield what a step of the motion, and its images, ask of a device: means over some steps."""
    motion, steps = Motion(device, COUNTED, pitch_mm, size), 4
    motion.batch.images(motion.next())
    press = motion.next()
    images, physics = motion.batch.images(press), batched_physics(motion.batch, gpu_schedule=True)
    physics(images)
    calls = {
        "contact and wrench": motion.next,
        f"image {size}": lambda: motion.batch.images(press),
        "heights of an image": lambda: physics.reader(images),
        "heights and force of an image": lambda: physics(images),
    }
    for what, call in calls.items():
        with HostReads() as reads, DeviceWork() as work:
            for _ in range(steps):
                call()
        name = f"{COUNTED} environments, {pitch_mm:g} mm: {what}"
        per_s = H100_BYTES_PER_S * COUNTED * steps / work.bytes
        yield Figure(f"{name}, kernels per step", work.kernels / steps)
        yield Figure(f"{name}, waits per step", (reads.count + work.scalars_read) / steps)
        yield Figure(
            f"{name}, MB per environment", work.bytes / 1e6 / COUNTED / steps, peer=f"so an H100 does ≤ {per_s:.3g} /s"
        )


def batched_physics(batch: TwinBatch, gpu_schedule: bool | None = None) -> BatchedPhysics:
    """Return the reader of the batch's images, with all that a calibrated one computes, and the estimator by physics."""
    grey, gel = batch._reference.cpu().numpy(), batch.twin.gel
    shape = replace(nominal_shape(grey), base_deflection=BaseDeflection(gel))
    reader = shape.depth_reader(Frame(cv2.cvtColor(np.uint8(grey), cv2.COLOR_GRAY2BGR)))
    physics = ScaledForceEstimator(build_traction_force(shape, gel), MODULUS_KNOWN)
    return BatchedPhysics(BatchedDepthReader(shape.rectify, reader, batch.device), physics, gpu_schedule)


def timed(motion: Motion, call: Any, seconds: float) -> tuple[float, Any]:
    """Return the mean time of a call, repeated for some seconds, and what it returned last."""
    motion.wait()
    start, calls = perf_counter(), 0
    while not calls or perf_counter() - start < seconds:
        found = call()
        motion.wait()
        calls += 1
    return (perf_counter() - start) / calls, found


def accuracy(device: Device, pitches_mm: Sequence[float], many: int, steps: int) -> Iterator[Figure]:
    """Yield the differences from the CPU's presses on the finest grid, and of each coarser grid from it."""
    finest, size = pitches_mm[0], "120x160"
    motions = {pitch: Motion(device, many, pitch) for pitch in pitches_mm}
    setup, alone = setup_at(finest, size), [None] * many
    exact = replace(setup.twin, solver_settings=SolverSettings(tolerance=1e-3, must_converge=False))
    wrong: dict[str, list[float]] = {}
    for step in range(steps):
        poses = poses_at(step, many)
        presses = {pitch: motion.next() for pitch, motion in motions.items()}
        images = {
            pitch: motion.batch._renderer.brightness_factors(presses[pitch].corrected) * motion.batch._reference
            for pitch, motion in motions.items()
        }
        images = {pitch: image.cpu().numpy() for pitch, image in images.items()}
        six = {pitch: press.corrected.wrenches().cpu().numpy() for pitch, press in presses.items()}
        for k in range(many):
            alone[k] = exact.press(alone[k], indenter_from_name("ball:4"), Pose(*poses[k]))
            load_n = max(-alone[k].wrench.six[2], 0.5)
            truth = cv2.cvtColor(setup.renderer.renderer.render_without_noise(alone[k].corrected), cv2.COLOR_BGR2GRAY)
            found = (
                (
                    f"{finest:g} mm from exact presses on the CPU",
                    six[finest][k],
                    images[finest][k],
                    alone[k].wrench.six,
                    truth,
                ),
            )
            for pitch in pitches_mm[1:]:
                each = six[pitch][k], images[pitch][k], six[finest][k], images[finest][k]
                found += ((f"{pitch:g} mm from {finest:g} mm", *each),)
            for name, wrench, image, wanted, seen in found:
                wrong.setdefault(f"{name}: force, share of the load", []).append(
                    float(np.abs(wrench - wanted)[:3].max() / load_n)
                )
                wrong.setdefault(f"{name}: image, grey levels RMS", []).append(
                    float(np.sqrt(np.mean((image - seen) ** 2)))
                )
    for name, values in wrong.items():
        largest, said = float(np.max(values)), f"median {np.median(values):.2g}; {many} x {steps} steps"
        if "CPU" in name and steps >= ROUND:
            yield at_most(f"{name}, largest", largest, WRENCH_SHARE if "force" in name else IMAGE_GREY, "")
        else:
            yield Figure(f"{name}, largest", largest, peer=said)


def drift(device: Device, pitch_mm: float, many: int, rounds: int) -> Iterator[Figure]:
    """Yield by how much the last round of the motion, which begins and ends without contact, differs from the second."""
    motion, second, drifted = Motion(device, many, pitch_mm), [], [0.0]
    for step in range(rounds * ROUND):
        six = motion.next().corrected.wrenches().cpu().numpy()
        if ROUND <= step < 2 * ROUND:
            second.append(six)
        elif step >= (rounds - 1) * ROUND:
            before = second[step % ROUND]
            drifted.append((np.abs(six - before)[:, :3] / np.maximum(-before[:, 2:3], 0.5)).max())
    name, steps = f"{pitch_mm:g} mm: drift of the force, share of the load", (rounds - 2) * ROUND
    yield replace(at_most(name, max(drifted), WRENCH_SHARE, ""), peer=f"over {steps} steps")


def sessions_rate(device: Device, many: int, quick: bool) -> Iterator[Figure]:
    """Yield contacts per second of sessions of `ninedtact simulate dataset`: solved and rendered, and with all else."""
    settings = GenerationSettings(
        1000 * many, sensors=min(20, many), session_pairs=1000, shares=PairKindShares(0, 0), rule=EVERY
    )
    if quick:
        settings = replace(settings, pitch_mm=0.6, size=(64, 48), sensors=1)
    setups = {number: make_simulated_sensor(number, settings) for number in range(settings.sensors)}
    executor, seconds, done = BatchExecutor(setups, device, many, print), 0.0, Counter()
    execute = executor.execute

    def timed_execute(requests: Sequence[StepRequest | RenderRequest]) -> list[Any]:
        nonlocal seconds
        start = perf_counter()
        responses = execute(requests)
        seconds += perf_counter() - start
        done[type(requests[0])] += sum(
            isinstance(requests[0], RenderRequest) or isinstance(one, Press) for one in responses
        )
        return responses

    executor.execute = timed_execute  # type: ignore[method-assign]
    sessions = [SimulatedPressSession(number, settings, setups[number % len(setups)]) for number in range(many)]
    running = run_sessions({one.number: one.requests() for one in sessions}, executor, 4)
    for _ in range(1 if quick else 12):
        next(running)
    seconds, start = 0.0, perf_counter()
    done.clear()
    for _ in range(2 if quick else 16):
        next(running)
    all_s, steps = perf_counter() - start, max(done[StepRequest], 1)
    name = f"{many} sessions of a data set, contacts"
    if device.kind == "cuda":
        yield at_least(f"{name} solved and rendered per s", steps / seconds, SESSIONS_REQUIRED, "per s")
    else:
        yield Figure(f"{name} solved and rendered per s", steps / seconds)
    yield Figure(f"{name}, with motion, noise and PNG per s", steps / all_s)


if __name__ == "__main__":
    tyro.cli(gpu_throughput)

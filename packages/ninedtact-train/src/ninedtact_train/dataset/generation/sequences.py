"""Generates a data set of sequences: objects that move over simulated sensors at 60 images per second, with true pose and slip.

Every file is one sequence, which depends on the settings and its number alone, and is written completely or not at all: a run that
was stopped continues with the missing ones. The motions are those of `ninedtact.simulation.object_motions`.
"""

from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.design import rectified_mm_per_px
from ninedtact.errors import InputError, SimulationError
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import InvalidPose, Pose
from ninedtact.parallel_jobs import Workers, require_workers, run_writing_jobs
from ninedtact.quantities import NO_OBJECT
from ninedtact.simulation.object_motions import HZ, MOTION_KINDS, MotionSettings, MotionStep, play_motion
from ninedtact.simulation.twin import Twin
from ninedtact_train.batched.session_requests import SimulatedSetup
from ninedtact_train.dataset.dataset_card import compute_dataset_statistics, format_sequences_card
from ninedtact_train.dataset.folder import CARD_FILE, pair_file
from ninedtact_train.dataset.generation.generate import GenerationResult, begin_generation, cached_setup
from ninedtact_train.dataset.generation.press_session import CONTACT_LOST, load_object, max_offset_mm
from ninedtact_train.dataset.generation.settings import SequenceSettings
from ninedtact_train.dataset.parquet_files import write_sequence_file
from ninedtact_train.dataset.schema import DatasetRow, MotionTruth

_FEWEST_IMAGES, _MOST_ATTEMPTS = 40, 20
"""A motion that ends sooner, because the object leaves the gel or would go through it, is sampled again, so many times."""
_MARGIN_MM = 2.5
"""Part of the sensing area that is left for the motion on each side of the press, where there is room."""
_SHALLOW_MM = 0.05


def generate_sequences(
    out: Path, settings: SequenceSettings, workers: Workers = 1, *, progress: bool = False
) -> GenerationResult:
    """Generate a data set of sequences in a folder, or continue a run that was stopped with the same settings.

    workers: number of processes, or a cluster of processors. Raises `InputError`, `OutputError`, `FileNotWritten`.
    """
    from tqdm import tqdm

    require_workers(workers)
    begin_generation(out, settings.sensors_and_objects, settings.to_json_dict())
    files = [pair_file(out, number, settings.sequences) for number in range(settings.sequences)]
    missing = [number for number, file in enumerate(files) if not file.is_file()]
    jobs = [(files[number].name, settings, number) for number in missing]
    done = run_writing_jobs(make_sequence_file, out / "data", jobs, workers)
    for _ in tqdm(done, total=len(files), initial=len(files) - len(jobs), unit="sequence", disable=not progress):
        pass
    statistics = compute_dataset_statistics(files)
    card = format_sequences_card(settings, statistics, version("ninedtact"))
    write_file_atomically(out / CARD_FILE, card.encode())
    return GenerationResult(out, statistics, len(missing), "cpu")


def make_sequence_file(folder: Path, name: str, settings: SequenceSettings, number: int) -> int:
    """Make the file of one sequence and return its number of images; raises `FileNotWritten`, `InputError`."""
    shared = settings.sensors_and_objects
    turn, objects = number // len(MOTION_KINDS), shared.selected_objects
    setup, kind = cached_setup(turn % settings.sensors, shared), MOTION_KINDS[number % len(MOTION_KINDS)]
    object_name = objects[(number + turn) % len(objects)]  # an object makes another motion at every turn
    indenter, rng = load_object(object_name, settings.objects_seed), np.random.default_rng([settings.seed, 4, number])
    for _ in range(_MOST_ATTEMPTS):
        friction = _log_uniform(rng, settings.friction)
        twin = replace(setup.twin, friction=friction)
        steps = _play(twin, indenter, kind, settings, rng)
        if len(steps) >= _FEWEST_IMAGES:
            images = list(_rows(steps, setup, settings, (number, kind, object_name, friction), rng))
            write_sequence_file(folder / name, images)
            return len(images)
    raise InputError(
        expected=f"an object that can move on the gel ({kind})",
        got=f"{object_name}, which left it or went through it {_MOST_ATTEMPTS} times",
        remedy="name smaller objects",
    )


def _play(
    twin: Twin, indenter: Indenter, kind: str, settings: SequenceSettings, rng: np.random.Generator
) -> list[MotionStep]:
    """Return the steps of a motion with a sampled place, load and speed, as far as the twin allows them."""
    twist_rad, direction_rad = rng.uniform(-np.pi, np.pi, 2).tolist()
    reach_mm = np.maximum(max_offset_mm(indenter, twist_rad, twin.area_mm) - _MARGIN_MM, 0)
    x_mm, y_mm = rng.uniform(-reach_mm, reach_mm).tolist()
    load_n, speed_mm_s = (_log_uniform(rng, one) for one in (settings.load_n, settings.speed_mm_s))
    steps = list[MotionStep]()
    try:
        pressed = twin.press(None, indenter, Pose(x_mm, y_mm, _SHALLOW_MM, twist_rad), load_n)
        motion = MotionSettings(pressed.pose, speed_mm_s, twin.friction, direction_rad).motion(kind)
        for step in play_motion(twin, indenter, motion):
            steps.append(step)
    except (*CONTACT_LOST, InvalidPose, SimulationError):
        pass  # what was before is whole
    return steps


def _rows(
    steps: list[MotionStep],
    setup: SimulatedSetup,
    settings: SequenceSettings,
    labels: tuple[int, str, str, float],
    rng: np.random.Generator,
) -> Iterator[tuple[DatasetRow, MotionTruth]]:
    """Yield the rows of one sequence. labels: its number, kind, object and friction coefficient."""
    number, kind, object_name, friction = labels
    mm_per_px = rectified_mm_per_px(settings.size, setup.member.design)
    for index, step in enumerate(steps):
        press, pose, slip = step.press, step.press.pose, step.slip
        row = DatasetRow(
            id=f"train-{number:05d}-{index:05d}",
            image=encode_png(setup.renderer.render(press.corrected, rng)),
            reference_id=setup.member.name,
            wrench=press.wrench.six.astype(np.float32),
            object=object_name if press.touches else NO_OBJECT,
            contact_id=f"{number:05d}",
            step=index,
            time_ns=round(index * 1e9 / HZ),
            sensor=setup.member.name,
            kind="stream",
            source=None,
            mm_per_px=mm_per_px,
        )
        x_mm, y_mm, depth_mm = float(pose.x_mm), float(pose.y_mm), float(pose.depth_mm)
        twist_deg, tilt_y_deg = np.degrees([pose.twist_rad, pose.tilt_y_rad]).tolist()
        moved = x_mm, y_mm, depth_mm, twist_deg, tilt_y_deg
        yield row, MotionTruth(kind, friction, *moved, slip.state, slip.sticking_share, slip.speed_mm_s)


def _log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(*np.log(bounds))))

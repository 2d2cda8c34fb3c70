"""A recording as files of their own: images, tables, heights, and the sensor's folder."""

import csv
import json
from collections.abc import Callable, Iterable
from dataclasses import asdict
from io import StringIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ninedtact.atomic_write import write_file_atomically
from ninedtact.errors import NinedtactError
from ninedtact.quantities import Wrench
from ninedtact.recording.reader import FOLDER, Recording, write_copy
from ninedtact.recording.ros_messages import Topic
from ninedtact.recording.saved_pairs import SavedPairReader
from ninedtact.recording.summary import summarise_recording

SIX = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
QUICK_PNG = (cv2.IMWRITE_PNG_COMPRESSION, 1)


class ExportRefused(NinedtactError):
    """A folder with other content."""


def export_recording(episode: Recording, out: Path, on_image: Callable[[], None] = lambda: None) -> dict[str, int]:
    """Write everything into a new or empty folder; how many rows or files of each. Raises `ExportRefused`."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise ExportRefused(f"expected --out to be a new or empty folder, got {out}; choose another name")
    out.mkdir(parents=True, exist_ok=True)
    written = {
        "images": images(episode, out, on_image),
        "untouched": untouched(episode, out),
        "measured": wrenches(episode, out / "wrench_measured.csv", Topic.MEASURED),
        "estimated": wrenches(episode, out / "wrench_estimated.csv", Topic.ESTIMATED),
        "heights": heights(episode, out / "heights"),
        "pairs": pairs(episode, out / "pairs.csv"),
        "events": events(episode, out / "events.csv"),
        "sensor": sum(write_copy(out / FOLDER, copied.name, copied.data) for copied in episode.attachments()),
    }
    write_file_atomically(
        out / "recording.json", json.dumps(asdict(summarise_recording(episode)), indent=2, ensure_ascii=False).encode()
    )
    return written


def images(episode: Recording, out: Path, on_image: Callable[[], None]) -> int:
    """Every image as PNG, named by its number, and a table of their times."""
    rows = []
    for frame in episode.frames():
        name = f"image_{frame.index:08d}.png"
        write_png(out / "images" / name, frame.image)
        rows.append((name, *times(episode, frame.stamp_ns)))
        on_image()
    return table(out / "images.csv", ("image", *TIMES), rows)


def untouched(episode: Recording, out: Path) -> int:
    """The images of untouched skin, named by the tare that they belong to."""
    count = 0
    for count, frame in enumerate(episode.frames(Topic.UNTOUCHED), start=1):
        write_png(out / "untouched" / f"untouched_{frame.index:03d}_{count:05d}.png", frame.image)
    return count


def wrenches(episode: Recording, path: Path, topic: Topic) -> int:
    """A table of wrenches about the skin's centre."""
    return table(path, (*TIMES, *SIX), ((*times(episode, one.stamp_ns), *six(one)) for one in episode.wrenches(topic)))


def heights(episode: Recording, out: Path) -> int:
    """Every height map in mm, NaN out of view, named by its image's number."""
    names = []
    for index, z_mm in episode.heights():
        out.mkdir(exist_ok=True)
        names.append(f"height_{index:08d}.npy")
        np.save(out / names[-1], z_mm)
    return len(names)


def pairs(episode: Recording, path: Path) -> int:
    """A table of what was collected, undone contacts taken out."""
    rows = (
        (f"image_{mark.image:08d}.png", mark.object, mark.contact, mark.kind, mark.untouched, *six(mark.wrench))
        for mark in SavedPairReader(episode).marks
    )
    return table(path, ("image", "object", "contact", "kind", "untouched", *SIX), rows)


def events(episode: Recording, path: Path) -> int:
    """A table of what else happened."""
    rows = ((*times(episode, one.stamp_ns), one.kind.value, one.subject, one.words) for one in episode.events())
    return table(path, (*TIMES, "kind", "subject", "words"), rows)


TIMES = ("monotonic_ns", "wall_ns")


def times(episode: Recording, stamp_ns: int) -> tuple[int, int]:
    """A stamp on both clocks."""
    return stamp_ns, episode.session.wall_ns(stamp_ns)


def six(wrench: Wrench) -> list[float]:
    """Six numbers."""
    return wrench.six.tolist()


def table(path: Path, heading: Iterable[str], rows: Iterable[Iterable[Any]]) -> int:
    """Write rows as CSV, if there are any; how many."""
    all_rows, text = list(rows), StringIO()
    csv.writer(text).writerows([list(heading), *map(list, all_rows)])
    if all_rows:
        write_file_atomically(path, text.getvalue().encode())
    return len(all_rows)


def write_png(path: Path, image: np.ndarray) -> None:
    """An image, whole."""
    path.parent.mkdir(exist_ok=True)
    write_file_atomically(path, bytes(cv2.imencode(".png", image, QUICK_PNG)[1]))

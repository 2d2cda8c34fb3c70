"""Files that people save from the page: one moment, and a video of a recording; and their limits.

Each file appears whole or not at all. All viewers of a page share one `SaveQuota`.
"""

import json
import os
import shutil
import time
from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from datetime import datetime
from functools import partial
from math import ceil
from pathlib import Path
from secrets import token_hex
from threading import Lock, RLock
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from numpy import ndarray as Array

from ninedtact.atomic_write import FileNotWritten, write_file_atomically
from ninedtact.errors import OutputError
from ninedtact.live.reading_recorder import ReadingRecorder, RecordedSensorMetadata
from ninedtact.live.wrench_history import WrenchSourceSnapshot
from ninedtact.reading import Reading
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights
from ninedtact.shape.export import export_shape

FORMATS = ("npy", "png", "ply")
_SAVED_BYTES_PER_PX = 100
"""Upper estimate of what the files of one reading take per pixel of the height map."""


class SaveQuota:
    """Counts what is saved from one page, and refuses what would exceed the limits."""

    def __init__(self, per_minute: int = 10, disk_share: float = 0.1) -> None:
        """disk_share: largest share of the disk space that was free before the first save."""
        self._per_minute, self._disk_share, self._saved_at_s = per_minute, disk_share, deque[float](maxlen=per_minute)
        self._written_bytes, self._lock, self._exporting = 0, RLock(), Lock()
        self.writing = Lock()
        """Held while the files of one moment are written."""

    def count_save(self, needed_bytes: int, folder: Path, what: str = "another reading") -> None:
        """Count one save, before it; raises `OutputError` where it is one too many, or its bytes are."""
        with self._lock:
            now_s = time.monotonic()
            if len(self._saved_at_s) == self._per_minute and (wait_s := self._saved_at_s[0] + 60 - now_s) > 0:
                raise OutputError(
                    expected=f"at most {self._per_minute} saves a minute",
                    got="one more",
                    remedy=f"wait {ceil(wait_s)} s, or use 'ninedtact record'",
                )
            self.require_space(needed_bytes, folder, what)
            self._saved_at_s.append(now_s)

    def require_space(self, needed_bytes: int, folder: Path, what: str) -> None:
        """Raise `OutputError` where so many more bytes than were counted are too many."""
        there = next(parent for parent in (folder.absolute(), *folder.absolute().parents) if parent.is_dir())
        with self._lock:
            allowed = self._disk_share * (shutil.disk_usage(there).free + self._written_bytes)
            if self._written_bytes + needed_bytes > allowed:
                raise OutputError(
                    expected=f"the page to save at most {self._disk_share:.0%} of the free disk, {allowed / 1e6:.0f} MB",
                    got=f"{self._written_bytes / 1e6:.0f} MB and {what}",
                    remedy="free the disk, or choose another folder with --out",
                )

    def add_bytes(self, written: int) -> None:
        """Count bytes that were written."""
        with self._lock:
            self._written_bytes += written

    def new_recorder(self, sensors: Sequence[RecordedSensorMetadata], out: Path) -> ReadingRecorder:
        """Return a recorder of readings with heights and labels, whose recordings count too."""

        def count_growth(more_bytes: int) -> None:
            self.add_bytes(more_bytes)
            self.require_space(0, out, "a recording in progress")

        refuse = partial(self.count_save, 0, out, "a recording")
        return ReadingRecorder(
            sensors, out, topics=(Topic.HEIGHTS, Topic.SPANS), before_start=refuse, on_growth=count_growth
        )

    @contextmanager
    def one_export(self) -> Iterator[None]:
        """Refuse, with `OutputError`, a second export while the block runs."""
        if not self._exporting.acquire(blocking=False):
            raise OutputError(
                expected="one export at a time", got="a second one", remedy="wait until the first has ended"
            )
        try:
            yield
        finally:
            self._exporting.release()


def save_moment_files(
    reading: Reading,
    status: str,
    wrenches: Iterable[WrenchSourceSnapshot],
    folder: Path,
    quota: SaveQuota,
    sensor: str = "",
) -> list[Path]:
    """Write camera image, heights (mm), and wrenches with errors and warnings, to files named by the time and the sensor's name.

    Raises `OutputError`, `FileNotWritten`.
    """
    with quota.writing:
        quota.count_save(reading.frame.image.nbytes + _SAVED_BYTES_PER_PX * reading.height.z_mm.size, folder)
        folder.mkdir(parents=True, exist_ok=True)
        name = f"reading_{datetime.now():%Y%m%d_%H%M%S_%f}" + f"_{sensor}" * bool(sensor)
        image, heights = folder / f"{name}_image.png", [folder / f"{name}_height.{ending}" for ending in FORMATS]
        write_file_atomically(image, cv2.imencode(".png", reading.frame.image)[1].tobytes())
        for path in heights:
            export_shape(reading.height, path)
        text = json.dumps(moment_json_dict(reading, status, wrenches), indent=2, ensure_ascii=False, allow_nan=False)
        paths = [image, *heights, folder / f"{name}_moment.json"]
        write_file_atomically(paths[-1], text.encode())
        quota.add_bytes(sum(path.stat().st_size for path in paths))
        return paths


def moment_json_dict(reading: Reading, status: str, wrenches: Iterable[WrenchSourceSnapshot]) -> dict[str, Any]:
    """Return the numbers and words of a moment for JSON: N and N·m, one standard deviation, null where none is known."""
    return {
        "stamp_ns": reading.stamp_ns,
        "image": reading.frame.index,
        "status": status,
        "max_indentation_mm": reading.max_indentation_mm,
        "contact_area_mm2": reading.contact_area_mm2,
        "warnings": list(map(str, reading.warnings)),
        "wrenches": [
            {
                "name": each.name,
                "meaning": each.meaning,
                "stamp_ns": each.sample.wrench.stamp_ns,
                "force_n": _finite_numbers(each.sample.wrench.force_n),
                "torque_nm": _finite_numbers(each.sample.wrench.torque_nm),
                "std": _finite_numbers(each.sample.std),
                "warnings": list(map(str, each.sample.warnings)),
                "notices": list(each.notices),
            }
            for each in wrenches
            if each.sample is not None
        ],
    }


def _finite_numbers(values: Float64[Array, " n"]) -> list[float | None]:
    return [float(value) if np.isfinite(value) else None for value in values]


def save_video(readings: Iterable[Reading], scale: ColourScale, hz: float, path: Path, quota: SaveQuota) -> None:
    """Write camera image and heights side by side as MP4 (MPEG-4).

    Raises `FileNotWritten`, also where the disk is full, which OpenCV does not report by itself.
    """
    partial, count, writer = path.with_name(f".{token_hex(6)}.partial.mp4"), 0, cv2.VideoWriter()
    path.parent.mkdir(parents=True, exist_ok=True)
    first_ns: int | None = None
    try:
        for reading in readings:
            first_ns = reading.stamp_ns if first_ns is None else first_ns
            picture = _draw_picture(reading, scale, (reading.stamp_ns - first_ns) / 1e9)
            if not writer.isOpened():
                rate = round(hz, 2)  # MPEG-4 holds a rate as a fraction of numbers up to 65535
                name, size = os.fsencode(partial), picture.shape[1::-1]  # see `VideoFile`: a text may end the process
                writer.open(name, cv2.VideoWriter.fourcc(*"mp4v"), rate, size)  # type: ignore[call-overload]
            writer.write(picture)
            count += 1
            quota.require_space(partial.stat().st_size if partial.exists() else 0, path.parent, "another video")
        writer.release()
        _require_images(partial, count, path)
        quota.require_space(partial.stat().st_size, path.parent, "another video")
        quota.add_bytes(partial.stat().st_size)
        partial.replace(path)
    finally:
        writer.release()
        partial.unlink(missing_ok=True)


def _require_images(video: Path, count: int, final: Path) -> None:
    """Read the number of images back; raises `FileNotWritten` where some are missing."""
    reader = cv2.VideoCapture(os.fsencode(video))  # type: ignore[call-overload]
    written = int(reader.get(cv2.CAP_PROP_FRAME_COUNT)) if reader.isOpened() else 0
    reader.release()
    if written != count or count == 0:
        raise FileNotWritten(
            expected=f"to write {count} images to {final}",
            got=f"{written}",
            remedy="free the disk or correct the folder's permissions",
        )


def _draw_picture(reading: Reading, scale: ColourScale, at_s: float) -> UInt8[Array, "rows cols 3"]:
    image, heights = reading.frame.image, colourise_heights(reading.height, scale)
    rows = image.shape[0]
    heights = cv2.resize(heights, (round(heights.shape[1] * rows / heights.shape[0]), rows))
    picture = cv2.copyMakeBorder(np.hstack([image, heights]), 0, 24, 0, 0, cv2.BORDER_CONSTANT, value=(40, 40, 40))
    text = f"{at_s:.2f} s   {reading.max_indentation_mm:.2f} mm   {reading.contact_area_mm2:.1f} mm2"
    if reading.wrench is not None:
        text += "   F " + " ".join(f"{value:+.2f}" for value in reading.wrench.force_n) + " N"
    cv2.putText(picture, text, (6, rows + 17), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (240, 240, 240), 1, cv2.LINE_AA)
    even = picture[: picture.shape[0] // 2 * 2, : picture.shape[1] // 2 * 2]
    return np.ascontiguousarray(even)

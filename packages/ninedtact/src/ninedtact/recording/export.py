"""Exports a recording to separate files: images, CSV tables, heights, and the folder of the sensor."""

import json
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from ninedtact.atomic_write import create_folder_atomically, write_file_atomically
from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.csv_table import to_csv
from ninedtact.errors import OutputError
from ninedtact.recording.attached_sensor import SENSOR_FOLDER
from ninedtact.recording.errors import RecordingUnreadable
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic, decode_reference_grey

WRENCH_COLUMNS = ("force_x_n", "force_y_n", "force_z_n", "torque_x_nm", "torque_y_nm", "torque_z_nm")
"""Names of the six components of a wrench in exported files."""
_STD_COLUMNS = tuple(f"{name}_std" for name in WRENCH_COLUMNS)
_TIME_COLUMNS = ("time_s", "monotonic_ns", "wall_ns")


def export_recording(recording: Recording, out: Path, on_image: Callable[[], None] = lambda: None) -> dict[str, int]:
    """Write everything into a new or empty folder and return how many rows or files of each kind were written.

    Images are PNG, wrenches, times and warnings CSV, heights .npy in mm. `on_image` is called after every image. Raises
    `OutputError`, and `RecordingUnreadable` for a damaged recording or one that was cut short before its first image; the
    folder is then as it was before.

        with Recording("press.mcap") as recording:
            export_recording(recording, Path("press"))
    """
    return export_each_sensor([recording], out, on_image)


def export_each_sensor(
    recordings: Sequence[Recording], out: Path, on_image: Callable[[], None] = lambda: None
) -> dict[str, int]:
    """Write the sensors of one recording, each into a folder of its name where there are several, as `export_recording`."""
    require_empty_folder(out)
    require_exportable(recordings)
    written: Counter[str] = Counter()
    with create_folder_atomically(out) as folder:
        for recording in recordings:
            place = folder / recording.metadata.name if len(recordings) > 1 else folder
            place.mkdir(exist_ok=True)
            written.update(_export_into(recording, place, on_image))
    return dict(written)


def require_empty_folder(out: Path) -> None:
    """Raise `OutputError` for a path at which there is more than an empty folder."""
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise OutputError(expected="--out to be a new or empty folder", got=str(out), remedy="choose another name")


def require_exportable(recordings: Sequence[Recording]) -> None:
    """Raise `RecordingUnreadable` for a file that was cut short before its first image, which leaves nothing to export."""
    if any(one.is_finished or len(one.positions(Topic.IMAGES)) for one in recordings):
        return
    raise RecordingUnreadable(
        expected=f"images in {recordings[0].path}",
        got="a file that was cut short before its first image",
        remedy="copy it again whole",
    )


def _export_into(recording: Recording, out: Path, on_image: Callable[[], None]) -> dict[str, int]:
    written = {
        "images": _export_images(recording, out, on_image),
        "references": _export_references(recording, out),
        "heights": _export_heights(recording, out),
        "warned": len(recording.positions(Topic.WARNINGS)),
        **{kind: _write_csv(out / name, header, rows) for kind, name, header, rows in _tables_of(recording)},
        "sensor": len(files := recording.sensor_files()),
    }
    if files:
        recording.save_sensor_folder(out / SENSOR_FOLDER)
    summary = json.dumps(asdict(recording.summary()), indent=2, ensure_ascii=False)
    write_file_atomically(out / "recording.json", summary.encode())
    return written


def _tables_of(recording: Recording) -> Iterator[tuple[str, str, Sequence[str], Iterable[Iterable[Any]]]]:
    """Yield kind, file, columns and rows of every table whose rows belong to no other files.

    Wrenches are about the skin centre; the standard deviation of an unknown one is inf. Undone contacts have no pairs.
    """

    def at(stamp_ns: int) -> tuple[float, int, int]:
        return _times_of(recording, stamp_ns)

    wrench, warnings = (*_TIME_COLUMNS, *WRENCH_COLUMNS), (*_STD_COLUMNS, "warnings")
    measured = ((*at(one.stamp_ns), *one.six.tolist()) for one in recording.wrenches())
    yield "measured", "wrench_measured.csv", wrench, measured
    estimated = (
        (*at(one.wrench.stamp_ns), *one.wrench.six.tolist(), *one.std.tolist(), "; ".join(one.warnings))
        for one in recording.estimates()
    )
    yield "estimated", "wrench_estimated.csv", (*wrench, *warnings), estimated
    pairs = (
        (f"image_{pair.image:08d}.png", pair.object, pair.contact, pair.kind, pair.reference, *pair.wrench.six.tolist())
        for pair in recording.kept_labels()
    )
    yield "pairs", "pairs.csv", ("image", "object", "contact", "kind", "reference", *WRENCH_COLUMNS), pairs
    events = ((*at(event.stamp_ns), event.kind.value, event.subject, event.text) for event in recording.events())
    yield "events", "events.csv", (*_TIME_COLUMNS, "kind", "subject", "text"), events
    spans = ((span.label, *at(span.begin_ns), *at(span.end_ns)) for span in recording.spans())
    yield (
        "spans",
        "spans.csv",
        ("label", *(f"{end}_{name}" for end in ("begin", "end") for name in _TIME_COLUMNS)),
        spans,
    )


def _export_images(recording: Recording, out: Path, on_image: Callable[[], None]) -> int:
    rows = []
    for frame in recording.frames():
        name = f"image_{frame.index:08d}.png"
        _write_png(out / "images" / name, frame.image)
        rows.append((name, *_times_of(recording, frame.stamp_ns)))
        on_image()
    return _write_csv(out / "images.csv", ("image", *_TIME_COLUMNS), rows)


def _export_references(recording: Recording, out: Path) -> int:
    """Write the reference images (no contact), named by the tare that they belong to, and rectified ones by their stamps."""
    count = 0
    for count, frame in enumerate(recording.frames(Topic.REFERENCE), start=1):
        _write_png(out / "references" / f"reference_{frame.index:03d}_{count:05d}.png", frame.image)
    for message in recording.messages(Topic.REFERENCE_GREY):
        count += 1
        (out / "references").mkdir(exist_ok=True)
        grey = recording.decode(message, decode_reference_grey)
        np.save(out / "references" / f"rectified_{message.log_time}.npy", grey, allow_pickle=False)
    return count


def _export_heights(recording: Recording, out: Path) -> int:
    """Write every height map in mm, NaN out of view, named by the index of its image, and a table of their times and warnings."""
    warnings, rows = dict(recording.warnings()), []
    for (index, z_mm), stamp_ns in zip(recording.heights(), recording.stamps_ns(Topic.HEIGHTS).tolist(), strict=True):
        (out / "heights").mkdir(exist_ok=True)
        name = f"height_{index:08d}.npy"
        np.save(out / "heights" / name, z_mm)
        rows.append((name, *_times_of(recording, stamp_ns), "; ".join(warnings.get(index, ()))))
    return _write_csv(out / "heights.csv", ("height", *_TIME_COLUMNS, "warnings"), rows)


def _times_of(recording: Recording, stamp_ns: int) -> tuple[float, int, int]:
    """Return seconds since the recording began, and both clocks."""
    return (stamp_ns - recording.began_ns) / 1e9, stamp_ns, recording.metadata.wall_ns(stamp_ns)


def _write_csv(path: Path, header: Iterable[str], rows: Iterable[Iterable[Any]]) -> int:
    all_rows = list(rows)
    if all_rows:
        write_file_atomically(path, to_csv(header, all_rows))
    return len(all_rows)


def _write_png(path: Path, image: np.ndarray) -> None:
    path.parent.mkdir(exist_ok=True)
    write_file_atomically(path, encode_png(image))

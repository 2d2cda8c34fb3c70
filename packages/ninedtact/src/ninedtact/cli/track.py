"""ninedtact track: a recording, video or camera of a calibrated sensor → path and slip of the object that touches, as CSV."""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.result_and_interrupt import (
    count_images,
    given_or_recorded_sensor,
    print_notice,
    print_result,
    stop_on_signal,
)
from ninedtact.cli.shared_options import AboveZero, RecordedSensorOption, ReferenceOrFirstOption, SourceOption
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.reading import Reading
    from ninedtact.tracking import TrackedContacts

_AXES = "x_mm", "y_mm", "z_mm", "rx_deg", "ry_deg", "rz_deg"
COLUMNS = (
    *("frame", "time_s", "touching", "contacts", "state", "path", *_AXES, "yaw_deg"),
    *(f"{axis}_std" for axis in _AXES),
    *("slip", "p_incipient", "p_gross", "sticking_share", "slip_speed_mm_s", "friction", "friction_std"),
    *("torque_z_nm", "torque_z_nm_std"),
    *("overlap", "rms_mm", "key_frame", "reason"),
)


@dataclass(frozen=True)
class TrackCommand:
    """Follow the object that touches: its path and turn since it touched first, with errors, and its slip, one line for each image.

    What cannot be seen has an error that says so: the turn of a ball, for example, ±115°.
    """

    source: tyro.conf.Positional[SourceOption]
    sensor: RecordedSensorOption = None
    reference: ReferenceOrFirstOption = ()
    force: str | None = None
    """Estimator of the loads from which slip is found (physics if not given, where the sensor is calibrated for it)."""
    rectified: bool = False
    """The images of a video or folder are already rectified, and their sensor has no calibration: motion along the skin and slip,
    with an unknown scale of loads."""
    mm_per_px: float | None = None
    """With --rectified: mm on the skin per pixel; without it, the view is as wide as that of the published sensor."""
    reference_frames: Annotated[str | None, tyro.conf.arg(metavar="FIRST:END")] = None
    """With --rectified: images without contact by their numbers, such as 0:10; without it, the first until something changes."""
    rate_hz: AboveZero | None = None
    """With --rectified: images per second; without it, the times of the video, and 10 for a folder."""
    out: Path | None = None
    """New CSV file for the path."""
    json: bool = False
    """Print the result as one JSON object; what is not known is null."""

    def run(self) -> int:
        """Follow the object through every image and print how far it went; return 1 where a file is damaged or a camera lost, after
        what came before it; raises that error where nothing did."""
        import ninedtact
        from ninedtact.atomic_write import require_new_file
        from ninedtact.errors import CameraError, FileFormatError
        from ninedtact.tracking import ContactTracker

        require_new_file(self.out)
        if self.rectified:
            return self._run_rectified()
        of_rectified = {
            "--mm-per-px": self.mm_per_px,
            "--reference-frames": self.reference_frames,
            "--rate-hz": self.rate_hz,
        }
        for option in (name for name, value in of_rectified.items() if value is not None):
            raise InputError(
                expected=f"{option} with --rectified",
                got="it without",
                remedy="add --rectified, or drop it",
            )
        tracker, rows = ContactTracker(), list[dict[str, Any]]()
        damage: FileFormatError | CameraError | None = None
        with given_or_recorded_sensor(self.sensor, self.source) as folder:
            force = _available_force(folder) if self.force is None else self.force
            sensor = ninedtact.open(folder, self.source, force, self.reference, follow_reference=False)
            with stop_on_signal() if sensor.source.is_live else nullcontext() as stop, sensor:
                if stop is not None:
                    print_notice(f"following what touches {sensor.source.name} until Ctrl-C")
                first_ns: int | None = None
                try:
                    for reading in sensor:
                        first_ns = reading.stamp_ns if first_ns is None else first_ns
                        rows.append(_row(reading, tracker.update(reading), first_ns))
                        if stop is not None and stop.now:
                            break
                except (FileFormatError, CameraError) as error:
                    if not rows:
                        raise
                    damage = error
        if self.out is not None:
            _write_csv(self.out, rows, COLUMNS)
        print_result(self.json, {"path": rows}, self._format(rows))
        return _report_damage(damage, len(rows))

    def _run_rectified(self) -> int:
        """Follow the object through rectified images."""
        from ninedtact.cli.track_rectified import RECTIFIED_COLUMNS, summarise_rectified_track, track_rectified

        for option, value in (("--sensor", self.sensor), ("--force", self.force)):
            if value is not None:
                raise InputError(expected=f"{option} or --rectified", got="both", remedy="drop one of them")
        rows, damage = track_rectified(self.source, self.reference, self.reference_frames, self.mm_per_px, self.rate_hz)
        if self.out is not None:
            _write_csv(self.out, rows, RECTIFIED_COLUMNS)
        written = () if self.out is None else (f"wrote {self.out}",)
        print_result(self.json, {"path": rows}, (*summarise_rectified_track(rows), *written))
        return _report_damage(damage, len(rows))

    def _format(self, rows: list[dict[str, Any]]) -> Iterator[str]:
        tracked = [row for row in rows if row["state"] == "tracked"]
        yield f"{len(rows)} images, {len(tracked)} with an object that was followed"
        for path in sorted({row["path"] for row in tracked}):
            last = [row for row in tracked if row["path"] == path][-1]
            yield (
                f"path {path}: moved by ({last['x_mm']:.2f}, {last['y_mm']:.2f}, {last['z_mm']:.2f}) mm "
                f"± ({last['x_mm_std']:.2f}, {last['y_mm_std']:.2f}, {last['z_mm_std']:.2f}), turned by "
                f"{last['yaw_deg']:.1f}° ± {last['rz_deg_std']:.1f}° about z at {last['time_s']:.2f} s"
            )
        for slip in ("static", "incipient", "gross"):
            times_s = [row["time_s"] for row in rows if row["slip"] == slip]
            if times_s:
                yield f"slip is {slip} in {len(times_s)} images, first at {times_s[0]:.2f} s"
        known = [row for row in rows if isfinite(row["friction"])]
        if known:
            yield f"friction coefficient {known[-1]['friction']:.2f} ± {known[-1]['friction_std']:.2f}"
        reasons = [row["reason"] for row in rows if row["reason"]]
        for reason in dict.fromkeys(reasons):
            yield f"lost in {reasons.count(reason)} images: {reason}"
        if self.out is not None:
            yield f"wrote {self.out}"


def _report_damage(damage: Exception | None, images: int) -> int:
    """Print what ended a source early, if something did; return the exit code."""
    if damage is None:
        return 0
    print_notice(f"{damage} ({count_images(images)} followed before)")
    return 1


def _available_force(folder: "SensorFolder") -> str:
    """Return the name of the estimator that needs no file, or none for a calibration that allows no estimate."""
    if folder.shape.deblurring is not None:
        return "physics"
    print_notice("slip is not known: the sensor is not calibrated for force by physics")
    return "none"


def _row(reading: "Reading", found: "TrackedContacts", first_ns: int) -> dict[str, Any]:
    import numpy as np

    motion, slip = found.motion, found.slip
    force = None if found.reading.force is None else found.reading.force.about_skin_centre()
    moved_mm, turned_deg = motion.moved_mm, np.degrees(motion.motion.rotation_vector_rad)
    std = np.concatenate([motion.std[:3], np.degrees(motion.std[3:])])
    numbers = [*moved_mm, *turned_deg, np.degrees(motion.motion.yaw_rad)]
    return {
        "frame": reading.frame.index,
        "time_s": (reading.stamp_ns - first_ns) / 1e9,
        "touching": bool(found.contacts),
        "contacts": len(found.contacts),
        "state": str(motion.state),
        "path": motion.path,
        **{
            name: float(value) if motion.is_known else float("nan")
            for name, value in zip((*_AXES, "yaw_deg"), numbers, strict=True)
        },
        **{f"{name}_std": float(value) for name, value in zip(_AXES, std, strict=True)},
        "slip": str(slip.state),
        "p_incipient": slip.p_incipient,
        "p_gross": slip.p_gross,
        "sticking_share": slip.sticking_share,
        "slip_speed_mm_s": slip.speed,
        "friction": slip.friction,
        "friction_std": slip.friction_std,
        "torque_z_nm": float("nan") if force is None else float(force.wrench.torque_nm[2]),
        "torque_z_nm_std": float("nan") if force is None else float(force.std[5]),
        "overlap": motion.overlap,
        "rms_mm": motion.rms_mm,
        "key_frame": motion.is_key_frame,
        "reason": motion.reason,
    }


def _write_csv(path: Path, rows: list[dict[str, Any]], columns: Sequence[str]) -> None:
    from ninedtact.atomic_write import write_file_atomically
    from ninedtact.csv_table import to_csv

    write_file_atomically(path, to_csv(columns, ([_to_cell(row[name]) for name in columns] for row in rows)))


def _to_cell(value: Any) -> Any:
    """Return a value for a table; what is not known is an empty cell."""
    if isinstance(value, float):
        return float(f"{value:.6g}") if isfinite(value) else ""
    return value

"""ninedtact estimate: images or a recording of a calibrated sensor → the six-axis force, with its error."""

from collections.abc import Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from msgspec import Meta

from ninedtact.cli.result_and_interrupt import (
    count_images,
    given_or_recorded_sensor,
    print_notice,
    print_result,
    stop_on_signal,
)
from ninedtact.cli.shared_options import RecordedSensorOption, ReferenceOrFirstOption
from ninedtact.errors import InputError
from ninedtact.force.estimator_loading import PHYSICS

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.reading import Reading
    from ninedtact.sensor import Sensor

_Mm = Annotated[float, Meta(ge=-1e6, le=1e6)]
Point = tuple[_Mm, _Mm, _Mm]
COLUMNS = ("Fx_N", "Fy_N", "Fz_N", "Tx_Nm", "Ty_Nm", "Tz_Nm", "eFx", "eFy", "eFz", "eTx", "eTy", "eTz")


@dataclass(frozen=True)
class EstimateCommand:
    """Estimate the six-axis force on the skin from images, a video or a recording. Live: ninedtact live --force."""

    source: tyro.conf.Positional[tuple[str, ...]]
    """Images of the pressed gel; or one video, folder of images, or recording (.mcap); or a camera, stream or `sim`, until
    Ctrl-C."""
    sensor: RecordedSensorOption = None
    reference: ReferenceOrFirstOption = ()
    reference_at: tyro.conf.UseAppendAction[tuple[float, ...]] = ()
    """Moment of a recording, in seconds after its first image, at which the reference is taken anew for the rest of it, because the
    zero has drifted. Nothing may touch the gel then."""
    force: str = PHYSICS
    """physics (no training), or a force model (.onnx)."""
    about_mm: Point = (0.0, 0.0, 0.0)
    """Point that torques are about, in the sensor's frame: 0 0 -35 is the paper's force/torque sensor."""
    out: Path | None = None
    """New CSV file for the wrenches."""
    json: bool = False
    """Print the result as one JSON object; errors are null where nothing is estimated."""

    def run(self) -> int:
        """Estimate every image; return 1 where an image is bad, a video or recording is damaged or a camera lost, after what came
        before it; raises that error where nothing did."""
        from ninedtact.atomic_write import require_new_file
        from ninedtact.errors import CameraError, FileFormatError
        from ninedtact.shape.image_plausibility import ImageImplausible

        require_new_file(self.out)
        with given_or_recorded_sensor(self.sensor, self.source[0] if self.source else "") as folder:
            sensor = self.open_on_source(folder)
            found: list[dict[str, Any]] = []
            damage: FileFormatError | CameraError | ImageImplausible | None = None
            try:
                for name, reading in self.readings(sensor, folder):
                    found.append(self.row(name, reading))
            except (FileFormatError, CameraError, ImageImplausible) as error:
                if not found:
                    raise
                damage = error
        if self.out is not None:
            _write_csv(self.out, found)
        figures = {
            "estimator": sensor.estimator.name,
            "about_mm": self.about_mm,
            "notices": sensor.estimator.notices,
            "wrenches": found,
        }
        print_result(self.json, figures, [*format_estimates(found, self.out), *sensor.estimator.notices])
        if damage is not None:
            print_notice(f"{damage} ({count_images(len(found))} estimated before)")
        return 0 if damage is None else 1

    def open_on_source(self, folder: "SensorFolder") -> "Sensor":
        """Return the sensor on the named images, not yet opened; raises `InputError`."""
        import ninedtact

        return ninedtact.open(
            folder,
            self.named_source(),
            self.force,
            self.reference,
            follow_reference=False,
            reference_at_s=self.reference_at,
        )

    def readings(self, sensor: "Sensor", folder: "SensorFolder") -> "Iterator[tuple[str, Reading]]":
        """Yield the name and the reading of every image; of a camera, a stream or the twin until Ctrl-C."""
        from ninedtact.calibration.drift.reference_check import load_reference_image_checker

        check = load_reference_image_checker(folder)
        references = check.read_images(self.reference) if self.images_are_separate else []
        with stop_on_signal() if sensor.source.is_live else nullcontext() as stop, sensor:
            if stop is not None:
                print_notice(f"estimating what {sensor.source.name} shows until Ctrl-C")
            for fault in sensor.reference_faults:
                print_notice(f"the reference image is doubtful; {fault}")
            for reading in sensor:
                name = self._name_of(reading.frame.index, sensor.source)
                if self.images_are_separate:
                    check.require_press(name, reading, references)
                yield name, reading
                if self.images_are_separate:
                    sensor.estimator.forget()
                if stop is not None and stop.now:
                    return

    def _name_of(self, index: int, source: "FrameSource") -> str:
        """Return the file of an image, also of one in a folder, or the number of a frame."""
        from ninedtact.capture.frame_source import ImageFolder

        if _is_image(self.source[0]):
            return self.source[index]
        return str(source.images[index] if isinstance(source, ImageFolder) else index)

    @property
    def images_are_separate(self) -> bool:
        """Whether the images are unrelated in time: single images or a folder of them, as opposed to a video or a recording."""
        return all(_is_image(text) or Path(text).expanduser().is_dir() for text in self.source)

    def named_source(self) -> "str | FrameSource":
        """Return the named images as a source, or the address of another source; raises `InputError`."""
        if not self.source:
            raise InputError(expected="images of the pressed gel", got="none", remedy="name them after the options")
        if all(_is_image(text) for text in self.source):
            if not self.reference:
                raise InputError(
                    expected="--reference with single images", got="none", remedy="name a reference image (no contact)"
                )
            from ninedtact.capture.frame_source import ImageFileList

            return ImageFileList([Path(text).expanduser() for text in self.source])
        if len(self.source) > 1:
            raise InputError(
                expected="images, or one video, folder or recording",
                got=f"{len(self.source)} names that are not all images",
                remedy="run the command once for each",
            )
        return self.source[0]

    def row(self, name: str, reading: "Reading") -> dict[str, Any]:
        """Return the estimate of one image as plain numbers: forces in N, torques in N·m."""
        import numpy as np

        from ninedtact.force.estimator_and_scale import unknown_wrench_estimate

        force = (reading.force or unknown_wrench_estimate(reading.stamp_ns)).about(np.array(self.about_mm, float))
        return {
            "image": name,
            "time_ns": reading.frame.stamp_ns,
            "touching": force.touching,
            **dict(zip(COLUMNS, [*force.wrench.six.tolist(), *force.std.tolist()], strict=True)),
            "warnings": [str(warning) for warning in reading.warnings],
        }


def _is_image(text: str) -> bool:
    return text.lower().endswith((".png", ".jpg", ".jpeg", ".bmp"))


def _write_csv(path: Path, rows: Sequence[dict[str, Any]]) -> None:
    from ninedtact.atomic_write import write_file_atomically
    from ninedtact.csv_table import to_csv

    columns = ("image", "time_s", "time_ns", "touching", *COLUMNS, "warnings")
    first_ns = rows[0]["time_ns"] if rows else 0
    cells = (
        {**row, "time_s": (row["time_ns"] - first_ns) / 1e9, "warnings": "; ".join(row["warnings"])} for row in rows
    )
    write_file_atomically(path, to_csv(columns, ([row[name] for name in columns] for row in cells)))


def format_estimates(rows: list[dict[str, Any]], out: Path | None) -> Iterator[str]:
    """Yield the lines that a person reads, one per image; torques in N·mm."""
    for row in rows:
        if not any(isfinite(row[name]) for name in COLUMNS[6:]):
            text = "not estimated"
        elif not row["touching"]:
            text = "nothing touches"
        else:
            forces = (_format_component(row, name, 1, 2, " N") for name in COLUMNS[:3])
            torques = (_format_component(row, name, 1e3, 1) for name in COLUMNS[3:6])
            text = "  ".join((*forces, *torques)) + " N·mm"
        yield f"{row['image']}: {text}" + (f"  ({', '.join(row['warnings'])})" if row["warnings"] else "")
    if out is not None:
        yield f"  wrenches: {out}"


def _format_component(row: dict[str, Any], column: str, factor: float, digits: int, unit: str = "") -> str:
    """Return one component of a wrench with its error, such as `Fz -2.01 ± 0.06 N`; an infinite error means not estimated."""
    name = column[:2]
    value, error = factor * row[column], factor * row[f"e{name}"]
    return f"{name} {value:+.{digits}f} ± {error:.{digits}f}{unit}" if isfinite(error) else f"{name} not estimated"

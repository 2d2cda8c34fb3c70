"""Recordings in Rerun: images, decimated surfaces, wrenches with error bands, on timelines in sensor time.

Entities, each below the name of the sensor:

    image        camera image, JPEG          wrench_estimated/force_z (and five more)  value, value − σ, value + σ
    heights      in colours, JPEG            wrench_measured/force_z (and five more)   value of the force/torque sensor
    surface      points in mm, coloured      warnings                                  warnings of the estimates, as text
    reference    rectified, without contact  sensor                                    its name, and the checksum of its calibration
    indentation  maximum indentation, mm
    contacts     outlines in mm, numbered    object    the point of the object that was the middle of its first contact, mm
    motion/x_mm, y_mm, z_mm, yaw_deg         value, value − σ, value + σ, while the object is followed
    slip/sticking_share, p_incipient, p_gross          slip/state  as text, where it changes

Forces are in N, torques in N·m about the skin centre. Timelines: `sensor_time`, the wall time of arrival of an image or sample,
and `image`, the number of the image in its source. Times of logging are not written.
"""

import os
from collections.abc import Callable
from pathlib import Path
from threading import Thread
from typing import BinaryIO

import cv2
import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float64, Int64
from numpy import ndarray as Array

from ninedtact.atomic_write import open_atomic_file
from ninedtact.errors import OutputError
from ninedtact.quantities import HeightMap, Rectified
from ninedtact.reading import Reading
from ninedtact.recording.export import require_exportable
from ninedtact.recording.followed_recording import follow_recording
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic, ros_name
from ninedtact.shape.coloured_height_map import ColourScale, colourise_heights
from ninedtact.shape.surface import point_cloud
from ninedtact.tracking import SlipState, TrackedContacts

SUFFIX = ".rrd"
COMPONENTS = ("force_x", "force_y", "force_z", "torque_x", "torque_y", "torque_z")
MOTION = ("x_mm", "y_mm", "z_mm", "yaw_deg")
SLIP = ("sticking_share", "p_incipient", "p_gross")
_LIFT_MM = 0.2
"""Height of outlines over the untouched skin."""
_PIPE_BYTES = 1 << 20
_JPEG_QUALITY = [cv2.IMWRITE_JPEG_QUALITY, 95]
_AXIS_COLOURS = {
    "estimated": ((214, 39, 40), (44, 160, 44), (31, 119, 180)),
    "measured": ((240, 160, 160), (160, 215, 160), (160, 200, 235)),
}
"""Of x, y and z."""
_EYE_MM, _LOOK_AT_MM = (0.0, -23.0, 21.0), (0.0, -1.0, -1.0)
"""From where the surface is shown at first: whole, from above and in front."""


class RerunLog:
    """What is written about one sensor to a Rerun stream. points_every: the points of every so many rows and columns."""

    def __init__(self, sensor: str, stream: rr.RecordingStream, points_every: int = 4) -> None:
        self._root, self._stream, self._points_every = f"/{ros_name(sensor)}", stream, points_every
        self._colours = ColourScale()
        self._slip = SlipState.UNKNOWN
        stream.set_log_time_enabled(False)
        stream.set_log_tick_enabled(False)

    def log_reading(self, reading: Reading, wall_ns: int) -> None:
        """Log image, heights, surface and indentation."""
        self._set_time(wall_ns, reading.frame.index)
        for entity, image in (("image", reading.image), ("heights", colourise_heights(reading.height, self._colours))):
            jpeg = cv2.imencode(".jpg", image, _JPEG_QUALITY)[1].tobytes()
            self._stream.log(f"{self._root}/{entity}", rr.EncodedImage(contents=jpeg, media_type="image/jpeg"))
        self._stream.log(f"{self._root}/surface", self._surface(reading.height))
        self._stream.log(f"{self._root}/indentation", rr.Scalars(reading.max_indentation_mm))

    def log_contacts(self, found: TrackedContacts, wall_ns: int) -> None:
        """Log contacts, the motion of the object and its slip; what is not known is empty."""
        self._set_time(wall_ns, found.reading.frame.index)
        root, motion, slip = self._root, found.motion, found.slip
        outlines = [np.vstack([one.outline_mm, one.outline_mm[:1]]) for one in found.contacts]
        strips = [np.pad(line, ((0, 0), (0, 1)), constant_values=_LIFT_MM) for line in outlines]
        labels = [f"{one.number}" for one in found.contacts]
        self._stream.log(f"{root}/contacts", rr.LineStrips3D(strips, labels=labels, colors=[(20, 20, 20)]))
        points = [motion.position_mm] if motion.is_known else []
        self._stream.log(f"{root}/object", rr.Points3D(points, radii=0.3, colors=[(0, 114, 178)]))
        values = (
            np.append(motion.moved_mm, np.degrees(motion.motion.yaw_rad)) if motion.is_known else np.full(4, np.nan)
        )
        std = np.append(motion.std[:3], np.degrees(motion.std[5]))
        for name, value, error in zip(MOTION, values.tolist(), std.tolist(), strict=True):
            self._stream.log(f"{root}/motion/{name}", rr.Scalars([value, value - error, value + error]))
        for name in SLIP:
            self._stream.log(f"{root}/slip/{name}", rr.Scalars([getattr(slip, name)]))
        if slip.state != self._slip:
            self._slip = slip.state
            self._stream.log(f"{root}/slip/state", rr.TextLog(str(slip.state)))

    def log_wrenches(
        self,
        name: str,
        wall_ns: Int64[Array, " n"],
        six: Float64[Array, "n 6"],
        std: Float64[Array, "n 6"] | None = None,
    ) -> None:
        """Log wrenches about the skin centre, N and N·m, with the band of one standard deviation where it is known and finite."""
        times = rr.TimeColumn("sensor_time", timestamp=wall_ns.astype("datetime64[ns]"))
        band = None if std is None else np.where(np.isfinite(std), std, np.nan)
        for number, component in enumerate(COMPONENTS):
            entity, values = f"{self._root}/{name}/{component}", six[:, number]
            lines = [values] if band is None else [values, values - band[:, number], values + band[:, number]]
            columns = np.stack(lines, 1).ravel()
            scalars = rr.Scalars.columns(scalars=columns).partition([len(lines)] * len(values))
            self._stream.send_columns(entity, indexes=[times], columns=scalars)
            names = [component, f"{component} − σ", f"{component} + σ"][: len(lines)]
            colour = _AXIS_COLOURS[name.removeprefix("wrench_")][number % 3]
            colours, widths = [colour] * len(lines), [2.0, 0.7, 0.7][: len(lines)]
            style = rr.SeriesLines(names=names, colors=colours, widths=widths)
            self._stream.log(entity, style, static=True)

    def log_sensor(self, name: str, calibration_checksum: str) -> None:
        """Log which sensor this is, and the checksum of its calibration (`SensorFolder.calibration_checksum`)."""
        text = f"sensor {name}\n\ncalibration {calibration_checksum or 'unknown'}"
        self._stream.log(f"{self._root}/sensor", rr.TextDocument(text), static=True)

    def log_reference(self, reference: Rectified, wall_ns: int, index: int) -> None:
        """Log the rectified reference image (no contact) against which heights are computed from this image on."""
        self._set_time(wall_ns, index)
        png = cv2.imencode(".png", np.clip(np.rint(reference.grey), 0, 255).astype(np.uint8))[1].tobytes()
        self._stream.log(f"{self._root}/reference", rr.EncodedImage(contents=png, media_type="image/png"))

    def log_warnings(self, warnings: list[str], wall_ns: int, index: int) -> None:
        """Log the warnings of an estimate."""
        self._set_time(wall_ns, index)
        self._stream.log(f"{self._root}/warnings", rr.TextLog("; ".join(warnings), level=rr.TextLogLevel.WARN))

    def log_blueprint(self) -> None:
        """Log which views are shown at first: image, heights, warnings, surface, forces, torques, indentation."""
        root, axes = self._root, "x red, y green, z blue; thin: ± σ; pale: measured"
        wrenches = [
            rrb.TimeSeriesView(
                name=f"{title}: {axes}",
                contents=[
                    f"{root}/wrench_{kind}/{part}_{axis}" for kind in ("measured", "estimated") for axis in "xyz"
                ],
                plot_legend=rrb.PlotLegend(visible=False),
            )
            for title, part in (("Force (N)", "force"), ("Torque (N·m)", "torque"))
        ]
        indentation = rrb.TimeSeriesView(
            name="Indentation (mm)", origin=f"{root}/indentation", plot_legend=rrb.PlotLegend(visible=False)
        )
        eye = rrb.EyeControls3D(position=_EYE_MM, look_target=_LOOK_AT_MM, eye_up=(0.0, 0.0, 1.0))
        motion = rrb.TimeSeriesView(name="Motion of the object (mm, °)", origin=f"{root}/motion")
        slip = rrb.TimeSeriesView(name="Slip", origin=f"{root}/slip")
        views = rrb.Horizontal(
            rrb.Vertical(
                rrb.Spatial2DView(name="Camera", origin=f"{root}/image"),
                rrb.Spatial2DView(name="Heights: blue pressed, red bulging", origin=f"{root}/heights"),
                rrb.TextLogView(name="Warnings", origin=f"{root}/warnings"),
                row_shares=[3, 3, 2],
            ),
            rrb.Spatial3DView(
                name="Surface (mm)",
                origin=root,
                contents=[f"{root}/{entity}" for entity in ("surface", "contacts", "object")],
                eye_controls=eye,
                line_grid=False,
            ),
            rrb.Vertical(*wrenches, indentation, motion, slip),
            column_shares=[3, 4, 4],
        )
        time_panel = rrb.TimePanel(timeline="sensor_time", state="collapsed")
        self._stream.send_blueprint(rrb.Blueprint(views, time_panel, collapse_panels=True))

    def _set_time(self, wall_ns: int, index: int) -> None:
        self._stream.set_time("sensor_time", timestamp=np.datetime64(wall_ns, "ns"))
        self._stream.set_time("image", sequence=index)

    def _surface(self, height: HeightMap) -> rr.Points3D:
        """Return the decimated surface in mm, in the colours of the live page."""
        points_mm = point_cloud(height, self._points_every).points_mm
        colours = self._colours.colour(points_mm[:, 2]).astype(np.uint8)
        return rr.Points3D(points_mm, colors=colours, radii=0.5 * self._points_every * height.mm_per_px)


def export_rerun(
    recording: Recording, out: Path, points_every: int = 4, on_image: Callable[[], None] = lambda: None
) -> dict[str, int]:
    """Write a recording as one new Rerun file (.rrd); return how much of each kind it has.

    Heights are computed from the images by the sensor of the recording. Raises `OutputError`, `FileNotWritten`, and
    `RecordingUnreadable` for a damaged recording or one without its sensor; no file is left then.
    """
    if out.suffix != SUFFIX or out.exists():
        raise OutputError(
            expected=f"--out to be a new file ending in {SUFFIX}", got=f"{out}", remedy="choose another name"
        )
    require_exportable([recording])
    out.parent.mkdir(parents=True, exist_ok=True)
    stream = rr.RecordingStream("ninedtact", recording_id=recording.metadata.id)
    with open_atomic_file(out) as file:
        with _StreamWriter(stream, file) as writer:

            def check_file() -> None:
                writer.raise_error()
                on_image()

            written = _log_recording(RerunLog(recording.sensor, stream, points_every), recording, check_file)
        writer.raise_error()
    return written


class _StreamWriter:
    """Writes what a Rerun stream holds to an open file (`with`), through a pipe and a thread.

    Rerun's own writer reports a full disk in its log alone and then may never return from closing the stream.
    """

    def __init__(self, stream: rr.RecordingStream, file: BinaryIO) -> None:
        self._stream, self._file = stream, file
        self._error: OSError | None = None
        self._thread = Thread(target=self._run, name="rerun file", daemon=True)

    def raise_error(self) -> None:
        """Raise the `OSError` that ended the writing of the file, if there was one."""
        if self._error is not None:
            raise self._error

    def __enter__(self) -> "_StreamWriter":
        self._reading_end, writing_end = os.pipe()
        self._thread.start()
        try:
            self._stream.save(f"/dev/fd/{writing_end}")
        finally:
            os.close(writing_end)  # the stream has opened it anew
        return self

    def __exit__(self, *_: object) -> None:
        self._stream.disconnect()
        self._thread.join()

    def _run(self) -> None:
        """Write until the stream is closed; after an error the pipe is still emptied, so that the stream can end."""
        with os.fdopen(self._reading_end, "rb", buffering=0) as pipe:
            while content := pipe.read(_PIPE_BYTES):
                try:
                    if self._error is None:
                        self._file.write(content)
                        self._file.flush()
                except OSError as trouble:
                    self._error = trouble


def _log_recording(log: RerunLog, recording: Recording, on_image: Callable[[], None]) -> dict[str, int]:
    log.log_blueprint()
    log.log_sensor(recording.sensor, recording.calibration_checksum)
    wall_ns, readings = recording.metadata.wall_ns, 0
    stamps_ns: dict[int, int] = {}
    reference: Rectified | None = None
    for readings, found in enumerate(follow_recording(recording), start=1):  # noqa: B007 - counted
        reading = found.reading
        stamps_ns[reading.frame.index] = reading.stamp_ns
        if reading.reference is not reference:
            reference = reading.reference
            log.log_reference(reference, wall_ns(reading.stamp_ns), reading.frame.index)
        log.log_reading(reading, wall_ns(reading.stamp_ns))
        log.log_contacts(found, wall_ns(reading.stamp_ns))
        on_image()
    written = {"readings": readings}
    estimates, measured = list(recording.estimates()), list(recording.wrenches(Topic.MEASURED))
    for name, wrenches, std in (
        ("wrench_estimated", [estimate.wrench for estimate in estimates], [estimate.std for estimate in estimates]),
        ("wrench_measured", measured, []),
    ):
        if wrenches:
            times = np.array([wall_ns(wrench.stamp_ns) for wrench in wrenches])
            log.log_wrenches(name, times, np.stack([wrench.six for wrench in wrenches]), np.stack(std) if std else None)
        written[name] = len(wrenches)
    warnings = [(index, words) for index, words in recording.warnings() if index in stamps_ns]
    for index, words in warnings:
        log.log_warnings(words, wall_ns(stamps_ns[index]), index)
    return written | {"warnings": len(warnings)}

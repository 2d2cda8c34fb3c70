"""Open a sensor: its folder, the source that it is read from, its reference images, and the estimator of its force.

    address ──▶ source ──▶ reference images ──▶ estimator ──▶ Sensor

A program calls this as `ninedtact.open`; the live page and the bridges read the same in real time (`live_sensor`). Packages
are imported when a sensor is opened, so that `ninedtact --help` stays quick.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ninedtact.bounds import checks_arguments
from ninedtact.errors import InputError
from ninedtact.source_addresses import RECORDING_SUFFIX, load_recorded_sensor, source_for

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.force.estimator_and_scale import ForceEstimator
    from ninedtact.sensor import Sensor

PathLike = Path | str


@checks_arguments
def open(  # noqa: A001 - users read `ninedtact.open`, as in `gzip.open`
    sensor: "PathLike | SensorFolder | None" = None,
    source: "PathLike | int | FrameSource" = "0",
    force: str = "physics",
    reference: PathLike | Sequence[PathLike] | None = None,
    settings: "CameraSettings | None" = None,
    follow_reference: bool | None = None,
    reference_at_s: float | Sequence[float] = (),
) -> "Sensor":
    """Return a calibrated sensor on a source, to be used in a `with` statement.

    Parameters
    ----------
    sensor
        Sensor folder written by `ninedtact calibrate`. May be left out when `source` is a recording, which carries its sensor.
    source
        Camera ("0", "/dev/video0", "csi:0"), stream (URL), video file, folder of images, recording (.mcap), "sim" for the
        sensor's twin pressed by several objects in turn, or any `FrameSource`. Cameras and streams serve their newest frame;
        files, recordings and the twin serve every frame.
    force
        "physics", the path of a force model (.onnx) or of the original project's weights (.pt), or "none".
    reference
        One or more reference images (no contact) of this session, averaged. Without any, opening the sensor takes the first
        frames, and nothing may touch the gel then.
    settings
        Exposure and white balance of a camera on this computer; fixed by default.
    follow_reference
        Whether the reference image follows slow changes of light and gel while nothing touches (`reference_images`). By
        default it follows on live sources (cameras, streams, the twin), and stays as it was taken on recordings, videos and images.
    reference_at_s
        Moment or moments of a recording, in seconds after its first image, at which the reference is taken anew. The readings from
        a moment on use it; those before do not change.

    Raises
    ------
    SensorFolderDamaged, CalibrationError, InputError, ForceModelUnusable,
    FileFormatError, ForceEstimationError, ReferenceUnusable
        The sensor, the source, the estimator or a reference image is not usable. Opening the returned sensor raises what
        its source raises.

    Examples
    --------
    >>> with ninedtact.open("my_sensor", source="sim", force="physics") as sensor:
    ...     reading = sensor.read()
    >>> reading.wrench.force_n  # nothing touches yet
    array([0., 0., 0.])
    """
    from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
    from ninedtact.capture.frame_pacing import LatestFrameSource
    from ninedtact.capture.frame_source import FIXED_EXPOSURE

    source = str(source) if isinstance(source, Path | int) else source
    references = [reference] if isinstance(reference, Path | str) else [] if reference is None else list(reference)
    moments_s = [reference_at_s] if isinstance(reference_at_s, int | float) else reference_at_s
    with ExitStack() as opened:
        if sensor is None:
            sensor = opened.enter_context(load_recorded_sensor(source))
        folder = sensor if isinstance(sensor, SensorFolder) else load_sensor(sensor)
        frames = source_for(source, settings or FIXED_EXPOSURE, folder) if isinstance(source, str) else source
        if isinstance(source, str) and frames.is_live and not frames.is_simulated:
            frames = LatestFrameSource(frames)  # a slow reader neither lags behind nor hears late of a loss
        return assemble_sensor(folder, frames, folder.estimator(force), references, follow_reference, moments_s)


def assemble_sensor(
    folder: "SensorFolder",
    frames: "FrameSource",
    estimator: "ForceEstimator",
    references: Sequence[PathLike],
    follow_reference: bool | None,
    moments_s: Sequence[float] = (),
) -> "Sensor":
    """Return a sensor on frames, not yet opened, with the reference images that are given or that its source brings.

    moments_s: as `reference_at_s` of `open`, which has the other parameters and says what is raised.
    """
    from ninedtact.calibration.drift.reference_check import load_reference_image_checker
    from ninedtact.reference_images import ReferenceImages, reference_following_settings_for
    from ninedtact.sensor import Sensor

    shape, check = folder.shape, load_reference_image_checker(folder)
    images = ReferenceImages(
        find_faults=check.find_faults, following=reference_following_settings_for(frames, follow_reference)
    )
    if references:
        images.given = shape.depth_reader(*check.read_images([Path(path) for path in references]))
    elif frames.reference_frames:
        images.given = shape.depth_reader(*frames.reference_frames)
    elif frames.recording is not None:
        from ninedtact.recording.recorded_references import read_first_reference
        from ninedtact.recording.recorded_source import RecordedFrameSource

        images.given = read_first_reference(frames.recording, folder, check)
        if images.given is not None and isinstance(
            frames, RecordedFrameSource
        ):  # wrapped, its frames have other stamps
            faults = images.given.reference_faults
            images.recorded = partial(
                frames.depth_reader_at, shape=shape, find_faults=check.find_faults, rectified_faults=faults
            )
    if moments_s and frames.recording is None:
        raise InputError(
            expected=f"a recording ({RECORDING_SUFFIX}) with a moment for the reference",
            got=f"{frames.name}",
            remedy="drop the moment, or call take_reference() of the sensor while nothing touches",
        )
    if moments_s and frames.recording is not None:
        from ninedtact.recording.recorded_references import read_references_at_moments

        before = None if images.given is None else images.given.reference
        images.at_moments = read_references_at_moments(frames.recording, moments_s, shape, check, before)
    images.begin()
    return Sensor(frames, shape, images, estimator)

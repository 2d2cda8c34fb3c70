"""ninedtact track --rectified: a video or folder of rectified images of a sensor without a calibration → motion and slip of the
object that touches.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ninedtact.cli.result_and_interrupt import print_notice
from ninedtact.errors import InputError

if TYPE_CHECKING:
    from ninedtact.capture.frame_source import FrameSource
    from ninedtact.reference_frames import ReferenceFrames
    from ninedtact.sensor import Sensor
    from ninedtact.tracking import TrackedImage

RECTIFIED_COLUMNS = (
    *("frame", "time_s", "state", "touching", "slip", "p_incipient", "p_gross", "sticking_share"),
    *("x_mm", "y_mm", "yaw_deg", "x_mm_std", "y_mm_std", "yaw_deg_std"),
    *("normal", "shear_x", "shear_y", "reason"),
)
_NOT_KNOWN = "depths, loads and friction have an unknown scale, and an object that tilts looks displaced"


def track_rectified(
    address: str,
    reference: Sequence[Path],
    reference_frames: str | None,
    mm_per_px: float | None,
    rate_hz: float | None,
) -> tuple[list[dict[str, Any]], Exception | None]:
    """Return a row for every image, and the error that ended the source early, if one did; raises it where nothing came before."""
    from ninedtact.errors import CameraError, FileFormatError
    from ninedtact.rectified_images import open_rectified
    from ninedtact.tracking import SequenceTracker

    source = _open_file(address)
    references = _references(source, reference, reference_frames)
    tracker, damage = SequenceTracker(rate_hz), None
    with open_rectified(source, references, mm_per_px) as sensor:
        print_notice(f"{_describe_scale(sensor, mm_per_px)}; {_NOT_KNOWN}")
        if not reference and reference_frames is None:
            print_notice(_describe_reference(references))
        try:
            for reading in sensor:
                tracker.add(reading)
        except (FileFormatError, CameraError) as error:
            damage = error
    rows = [_row(image) for image in tracker.finish()]
    if damage is not None and not rows:
        raise damage
    return rows, damage


def summarise_rectified_track(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield what was found, in lines for a person."""
    touching = [row for row in rows if row["touching"]]
    yield f"{len(rows)} {'image' if len(rows) == 1 else 'images'}, {len(touching)} with a contact"
    for slip in ("static", "incipient", "gross"):
        of_state = [row for row in touching if row["slip"] == slip]
        if of_state:
            yield f"{slip} in {len(of_state)}, first at {of_state[0]['time_s']:.2f} s"
    if touching:
        last = touching[-1]
        yield (
            f"moved by ({last['x_mm']:.2f}, {last['y_mm']:.2f}) mm ± ({last['x_mm_std']:.2f}, {last['y_mm_std']:.2f}) at "
            f"{last['time_s']:.2f} s"
        )
    reasons = [row["reason"] for row in rows if row["reason"]]
    for reason in dict.fromkeys(reasons):
        yield f"nothing known in {reasons.count(reason)}: {reason}"


def _open_file(address: str) -> "FrameSource":
    """Return the video or folder, not yet opened; raises `InputError` for another source."""
    from ninedtact.capture.source_from_address import camera_or_file_source
    from ninedtact.source_addresses import is_recording_address, is_twin_address

    is_file = not (is_recording_address(address) or is_twin_address(address))
    source = camera_or_file_source(address) if is_file else None
    if source is None or source.is_live:
        raise InputError(
            expected="a video or a folder of rectified images with --rectified",
            got=f"'{address}'",
            remedy="drop --rectified, and give --sensor for a camera; a recording brings its own sensor",
        )
    return source


def _references(source: "FrameSource", images: Sequence[Path], frames: str | None) -> "ReferenceFrames":
    """Return the reference images that the options name, or those of the source."""
    from ninedtact.capture.strict_image_reading import read_image, require_image_size
    from ninedtact.quantities import Frame
    from ninedtact.reference_frames import read_reference_frames

    chosen = None if frames is None else parse_frame_range(frames)
    if images and chosen is not None:
        raise InputError(expected="--reference or --reference-frames", got="both", remedy="drop one of them")
    if not images:
        return read_reference_frames(source, chosen)
    found, read = read_reference_frames(source), [read_image(path) for path in images]
    rows, cols = found.frames[0].image.shape[:2]
    for path, image in zip(images, read, strict=True):
        require_image_size(image, rows, cols, str(path))
    return replace(found, frames=tuple(Frame(image) for image in read))


def parse_frame_range(text: str) -> tuple[int, int]:
    """Return the first number and the end of a range such as 0:10; raises `InputError`."""
    found = re.fullmatch(r"(\d{1,9}):(\d{1,9})", text)
    if found is None or int(found[1]) >= int(found[2]):
        raise InputError(
            expected="--reference-frames as FIRST:END, such as 0:10", got=f"'{text}'", remedy="count images from 0"
        )
    return int(found[1]), int(found[2])


def _describe_scale(sensor: "Sensor", given_mm_per_px: float | None) -> str:
    """Return how wide the view is, and how that is known."""
    rectify = sensor.shape.rectify
    width_mm = rectify.source_px.shape[1] * rectify.mm_per_px
    if given_mm_per_px is not None:
        return f"no calibration: the view is {width_mm:.1f} mm wide"
    return f"no calibration: the view is taken to be {width_mm:.0f} mm wide (--mm-per-px)"


def _describe_reference(references: "ReferenceFrames") -> str:
    """Return which images of the source are the reference."""
    first, last = (references.frames[at].index for at in (0, -1))
    return f"images {first}:{last + 1} are taken to show no contact; name others with --reference-frames"


def _row(image: "TrackedImage") -> dict[str, Any]:
    from math import degrees

    motion, slip = image.motion, image.slip
    (x_mm, y_mm), (x_std, y_std) = motion.moved_mm.tolist(), motion.std_mm.tolist()
    shear_x, shear_y, outward = image.force_n.tolist()
    is_untouched = motion.state == "no contact"
    return {
        "frame": image.index,
        "time_s": image.time_s,
        "state": str(motion.state),
        "touching": motion.state == "tracked",
        "slip": image.slip_label,
        "p_incipient": 0.0 if is_untouched else slip.p_incipient,
        "p_gross": 0.0 if is_untouched else slip.p_gross,
        "sticking_share": slip.sticking_share,
        "x_mm": x_mm,
        "y_mm": y_mm,
        "yaw_deg": degrees(motion.yaw_rad),
        "x_mm_std": x_std,
        "y_mm_std": y_std,
        "yaw_deg_std": degrees(motion.yaw_std_rad),
        "normal": -outward,
        "shear_x": shear_x,
        "shear_y": shear_y,
        "reason": motion.reason,
    }

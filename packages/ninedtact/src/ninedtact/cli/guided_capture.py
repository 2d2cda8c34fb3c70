"""Takes the calibration images with a camera, while the terminal guides a person through the presses."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.cli.calibration_page import simulated_calibration_camera
from ninedtact.cli.result_and_interrupt import StatusLine, print_notice
from ninedtact.design import SECOND_KINDS, SecondKind, SensorDesign
from ninedtact.errors import CameraError, NinedtactError, OutputError
from ninedtact.source_addresses import is_twin_address, source_for

if TYPE_CHECKING:
    from ninedtact.calibration.guidance import CaptureStep
    from ninedtact.calibration.procedure import CalibrationImages
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.quantities import BgrImage


def capture_guided_images(
    source: str,
    design: SensorDesign,
    settings: CalibrationSettings,
    camera_settings: "CameraSettings",
    taken: "dict[str, BgrImage]",
    second: tuple[SecondKind, ...],
) -> "CalibrationImages":
    """Take the images with a camera into `taken`; raises what the camera raises, and `CameraError` for a
    recording."""
    from ninedtact.calibration.guidance import guided_capture_steps
    from ninedtact.calibration.procedure import CalibrationImages
    from ninedtact.capture.frame_pacing import LatestFrameSource

    status = StatusLine()
    simulated = simulated_calibration_camera(design) if is_twin_address(source) else None
    chosen = source_for(source, camera_settings) if simulated is None else simulated
    with LatestFrameSource(chosen) if chosen.is_live else chosen as camera:
        for step in guided_capture_steps(design, settings, second):
            status.print_title(step.instruction)
            if simulated is not None:
                simulated.follow(step.name)
            taken[step.name] = _follow_step(step, camera, taken, status)
    return CalibrationImages(**taken)


@contextmanager
def keep_images_of_failure(out: Path, taken: "dict[str, BgrImage]") -> Iterator[None]:
    """Where the block fails, keep the images of complete presses that a camera has taken, in a folder beside the sensor folder."""
    from ninedtact.calibration.procedure import BALL_NAMES, BOARD_NAMES, second_image_names
    from ninedtact.calibration.save import save_images_beside

    try:
        yield
    except (NinedtactError, OSError):
        complete = {
            name: taken[name]
            for pair in (BOARD_NAMES, BALL_NAMES, *map(second_image_names, SECOND_KINDS))
            for name in pair
            if taken.keys() >= {*pair}
        }
        if complete:
            with suppress(OutputError, OSError):  # the first failure is the one to report
                kept = save_images_beside(out, complete)
                again = f"--images {quote(str(kept))} in place of --source"
                print_notice(f"the images are kept in {kept}; run the command with {again}")
        raise


def _follow_step(
    step: "CaptureStep", camera: "FrameSource", taken: dict[str, "BgrImage"], status: StatusLine
) -> "BgrImage":
    """Watch frames until the step is complete; return the mean of the last few."""
    watch = step.watch(taken)
    with status.hold():
        for frame in camera:
            advice = watch(frame.image)
            status.update(advice.sentence)
            if advice.image is not None:
                return advice.image
    raise CameraError(
        expected=f"images until the step '{step.instruction}' was done",
        got="the end of the recording",
        remedy="record it longer",
    )

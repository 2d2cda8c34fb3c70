"""Calibration with a camera: the terminal guides a person through the two presses, hands free.

Nothing is asked: each step watches the images, says what it sees, and goes on by itself when it has what it needs.

ninedtact calibrate: one press of the board and one of the ball → a sensor folder with its certificate.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ninedtact.cli.devices import source_named
from ninedtact.cli.options import CalibrationOptions, DesignFileOption, DesignGivenTwice, read_design_or_default
from ninedtact.cli.terminal import print_result
from ninedtact.design import SensorDesign
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.calibration.board.detection import BoardNotFound
    from ninedtact.calibration.brightness import BgrImage
    from ninedtact.calibration.guidance import CaptureStep
    from ninedtact.calibration.procedure import Calibration, CalibrationImages, CalibrationSettings
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import FrameSource


@dataclass
class _LiveLine:
    """One line that is rewritten while a step goes on, and kept when it is done. Goes to standard error."""

    width: int = 100

    def title(self, words: str) -> None:
        """What to do now."""
        print(f"\n{words}", file=sys.stderr)

    def live(self, words: str) -> None:
        """What is seen at this moment."""
        print(f"\r  {words[: self.width]:<{self.width}}", end="", file=sys.stderr, flush=True)

    @contextmanager
    def line(self) -> Iterator[None]:
        """The line that a step writes on; whatever comes after it begins on a new one."""
        try:
            yield
        finally:
            print(file=sys.stderr)


def _capture_guided_images(
    source: str, design: SensorDesign, settings: "CalibrationSettings", automatic: bool
) -> "CalibrationImages":
    """Take the four images with a camera; raises what the camera raises, and `SourceEnded` from a recording."""
    from ninedtact.calibration.guidance import guided_capture_steps
    from ninedtact.calibration.procedure import CalibrationImages

    terminal = _LiveLine()
    taken: dict[str, BgrImage] = {}
    with _open_camera(source, automatic) as camera:
        for step in guided_capture_steps(design, settings):
            terminal.title(step.instruction)
            taken[step.name] = _follow_step(step, camera, taken, terminal)
    return CalibrationImages(**taken)


@contextmanager
def _open_camera(source: str, automatic: bool) -> "Iterator[FrameSource]":
    """The camera, newest image first; a recording is read image by image instead."""
    from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE
    from ninedtact.capture.latest_frame import LatestFrameSource

    camera = source_named(source, DEFAULT_CAMERA if automatic else FIXED_EXPOSURE)
    with LatestFrameSource(camera) if camera.recorded_hz is None else camera as frames:
        yield frames


def _follow_step(
    step: "CaptureStep", camera: "FrameSource", taken: dict[str, "BgrImage"], terminal: _LiveLine
) -> "BgrImage":
    """Watch images until the step is content; the mean of the last few."""
    watch = step.watch(taken)
    with terminal.line():
        for frame in camera:
            advice = watch(frame.image)
            terminal.live(advice.words)
            if advice.image is not None:
                return advice.image
    raise RecordingTooShort(
        f"expected images until the step '{step.instruction}' was done, got the end of the recording; record it longer"
    )


class RecordingTooShort(NinedtactError):
    """A recording that ended before all four images were taken."""


IMAGE_NAMES = ("board_reference", "board", "ball_reference", "ball")


class ImagesMissing(NinedtactError):
    """Neither four images nor a camera."""


@dataclass(frozen=True)
class CalibrateCommand:
    """Calibrate a sensor from one press of the pin board and one of the ball.

    Give the four images, and nothing is asked; or give --source, and the terminal guides you through the presses.
    """

    out: Path
    """Sensor folder to write; an older calibration there is replaced."""
    board_reference: tuple[Path, ...] = ()
    """Untouched skin before the board; several images are averaged."""
    board: tuple[Path, ...] = ()
    """The pin board pressed on the skin."""
    ball_reference: tuple[Path, ...] = ()
    """Untouched skin before the ball."""
    ball: tuple[Path, ...] = ()
    """The ball pressed on the skin, 1 to 2 mm deep, straight down."""
    source: str | None = None
    """Take the images with this camera: 0, /dev/video0, a stream's URL; or from a recording: a video, a folder."""
    automatic: bool = False
    """Leave the camera's automatic exposure and white balance on, for one that cannot switch them off; depths then drift."""
    ball_radius_mm: float | None = None
    """Radius of the ball; the design's (4 mm) if not given."""
    id: str | None = None
    """Name of the sensor; the folder's name if not given."""
    options: Annotated[CalibrationOptions, tyro.conf.arg(name="")] = CalibrationOptions()
    design_file: DesignFileOption = None
    """Design file (TOML) of the sensor; or its dimensions one by one, below."""
    design: SensorDesign = SensorDesign()
    json: bool = False
    """Print the certificate's figures as one JSON object."""

    def run(self) -> int:
        """CalibrateCommand, write the folder, say how good it is."""
        from ninedtact.calibration.board.detection import BoardNotFound
        from ninedtact.calibration.procedure import calibrate
        from ninedtact.calibration.save import save_sensor
        from ninedtact.calibration.sensor_folder import require_replaceable_folder

        require_replaceable_folder(self.out)
        try:
            made = calibrate(self.images(), self.resolved_design, self.options.settings(), self.id or self.out.name)
        except BoardNotFound as refusal:
            raise _write_overlay(refusal, self.out) from refusal
        sensor = save_sensor(self.out, made)
        return print_result(self.json, _to_json_dict(sensor, made), _format_calibration(sensor, made))

    @property
    def resolved_design(self) -> SensorDesign:
        """The design with the ball that was given; raises `DesignGivenTwice`, and what `read_design_file` raises."""
        design = self.design
        if self.design_file is not None:
            _require_no_dimensions(self.design_file, self.design)
            design = read_design_or_default(self.design_file)
        if self.ball_radius_mm is None:
            return design
        return replace(design, ball=replace(design.ball, radius_mm=self.ball_radius_mm))

    def images(self) -> "CalibrationImages":
        """From files, or from a guided session with a camera; raises `ImagesMissing`."""
        given = [name for name in IMAGE_NAMES if getattr(self, name)]
        if len(given) == len(IMAGE_NAMES) and self.source is None:
            return self.read_images()
        if self.source is not None and not given:
            return _capture_guided_images(self.source, self.resolved_design, self.options.settings(), self.automatic)
        options = ", ".join("--" + name.replace("_", "-") for name in IMAGE_NAMES)
        got = ", ".join("--" + name.replace("_", "-") for name in given) or "none of them"
        both = " and --source" if self.source is not None else ""
        raise ImagesMissing(
            f"expected all of {options}, or --source alone, got {got}{both}; give the four images or a camera"
        )

    def read_images(self) -> "CalibrationImages":
        """The four images, each the mean of the files given for it."""
        from ninedtact.calibration.procedure import CalibrationImages
        from ninedtact.capture.image_file import average_images, read_image

        return CalibrationImages(
            **{name: average_images([read_image(path) for path in getattr(self, name)]) for name in IMAGE_NAMES}
        )


def _require_no_dimensions(path: Path, given: SensorDesign) -> None:
    """Refuse single dimensions beside a file of them; raises `DesignGivenTwice`."""
    if given != SensorDesign():
        raise DesignGivenTwice(
            f"expected --design {path} or single --design.… options, got both; write them into the file"
        )


def _write_overlay(refusal: "BoardNotFound", out: Path) -> NinedtactError:
    """The refusal, naming an image of what was seen that is written beside the folder asked for."""
    import cv2

    from ninedtact.atomic_write import FileNotWritten, write_file_atomically
    from ninedtact.calibration.certificate.plot_style import draw_board_not_found

    path = out.with_name(f"{out.name}_board_not_found.png")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_file_atomically(path, cv2.imencode(".png", draw_board_not_found(refusal))[1].tobytes())
    except (OSError, FileNotWritten):
        return refusal
    return NinedtactError(f"{refusal}; what was seen is drawn in {path}")


def _to_json_dict(sensor: "SensorFolder", made: "Calibration") -> dict[str, object]:
    """The certificate for scripts."""
    import msgspec

    from ninedtact.calibration.certificate.checks import check_certificate, overall_check_level

    certificate = made.record.certificate
    assert certificate is not None
    told = {"sensor": str(sensor.path), "id": sensor.id, "verdict": overall_check_level(certificate)}
    return {
        **told,
        **msgspec.to_builtins(certificate),
        "checks": [asdict(line) for line in check_certificate(certificate)],
    }


def _format_calibration(sensor: "SensorFolder", made: "Calibration") -> Iterator[str]:
    """The certificate in a few lines."""
    from ninedtact.calibration.certificate.checks import certificate_headline

    assert made.record.certificate is not None
    board, ball = made.record.certificate.board, made.record.certificate.ball
    yield f"sensor {sensor.id} calibrated: {sensor.path}"
    yield (
        f"  board  {board.pins_found} of {board.pins_expected} pins, left-out error {board.loo_rms_mm:.3f} mm "
        f"(the original's way: {board.loo_rms_mm_original:.3f} mm)"
    )
    yield f"  scale  {board.mm_per_px:.5f} ± {board.mm_per_px_error:.5f} mm per pixel"
    yield (
        f"  ball   radius {ball.ball_radius_mm:g} mm pressed {ball.deepest_mm:.2f} mm, read back to "
        f"{ball.fit_mae_mm:.3f} mm, noise {ball.noise_mm:.4f} mm, method {ball.method}"
    )
    yield from (f"  warning: {warning}" for warning in made.record.certificate.warnings)
    yield f"  {certificate_headline(made.record.certificate)}"
    yield f"  open {sensor.path / 'certificate.html'} in a browser"

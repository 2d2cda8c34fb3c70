"""The commands and the terminal: one result on standard output, and a way to end long work with Ctrl-C."""

import json
import signal
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path
from threading import current_thread, main_thread
from time import monotonic
from types import FrameType
from typing import TYPE_CHECKING, Any

from ninedtact.cli.plain_text import prints_unicode
from ninedtact.errors import UNPRINTABLE, printable_text

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.force.estimator_and_scale import ForceEstimator

_HANGUP: signal.Signals | None = getattr(signal, "SIGHUP", None)
"""What a process gets when its terminal closes; None on systems without it."""


def print_result(as_json: bool, result: Mapping[str, Any], report_lines: Iterable[str]) -> int:
    """Print the result as one JSON object, or its report for a person; return the exit code 0.

    A number that is infinite or undefined is null in JSON, which has no other word for it (RFC 8259, section 6). Characters that
    the output cannot print are escaped there, so that names stay as they are.
    """
    if as_json:
        ascii_alone = not prints_unicode(sys.stdout)
        text = json.dumps(_with_null(result), indent=2, ensure_ascii=ascii_alone, allow_nan=False)
        print(UNPRINTABLE.sub(lambda found: f"\\u{ord(found[0]):04x}", text))
    else:
        print(printable_text("\n".join(report_lines)))
    return 0


def _with_null(value: Any) -> Any:
    """Return the value with None in place of numbers that are not finite, in mappings and sequences too."""
    if isinstance(value, float):
        return value if isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _with_null(part) for key, part in value.items()}
    return [_with_null(part) for part in value] if isinstance(value, list | tuple) else value


def print_notice(sentence: str) -> None:
    """Print one line about the progress of a command to standard error."""
    print(f"ninedtact: {printable_text(sentence)}", file=sys.stderr, flush=True)


def print_notices(sentences: Iterable[str]) -> None:
    """Print one line for each sentence to standard error."""
    for sentence in sentences:
        print_notice(sentence)


def count_images(number: int) -> str:
    """Return a number of images as the beginning of a sentence about them, such as `1 image was`."""
    return f"{number} {'image was' if number == 1 else 'images were'}"


@contextmanager
def sensor_replacement(folder: Path) -> Iterator[None]:
    """Replace the sensor in a folder in the block, and then print which later measurements were removed with the older sensor.

    Raises `SensorFolderNotReplaceable` before the block for a folder that cannot be replaced.
    """
    from ninedtact.calibration.save import list_later_measurements, removal_notices, require_replaceable_sensor_folder

    require_replaceable_sensor_folder(folder)
    measured = list_later_measurements(folder)
    yield
    print_notices(removal_notices(folder, measured))


def load_sensor_with_notices(path: Path) -> "SensorFolder":
    """Read the sensor folder that a command is given and print why its calibration is to be distrusted, if it is.

    Raises `SensorFolderDamaged`. Every command that needs no source reads its sensor here.
    """
    from ninedtact.calibration.sensor_folder import load_sensor

    folder = load_sensor(path)
    print_notices(folder.notices)
    return folder


@contextmanager
def given_or_recorded_sensor(sensor: Path | None, source: str) -> "Iterator[SensorFolder]":
    """Load the sensor that a command is given, or that its recording carries, as `load_sensor_with_notices`.

    Raises what `source_addresses.load_recorded_sensor` raises. Every command with a source reads its sensor here.
    """
    if sensor is not None:
        yield load_sensor_with_notices(sensor)
        return
    from ninedtact.source_addresses import load_recorded_sensor

    with load_recorded_sensor(source) as folder:
        print_notices(folder.notices)
        yield folder


def load_estimator_with_notices(force: str, folder: "SensorFolder") -> "ForceEstimator":
    """Return the estimator that --force names and print what is to be known about it."""
    estimator = folder.estimator(force)
    print_notices(estimator.notices)
    return estimator


@dataclass
class StopSignal:
    """Whether long work is to end: after a Ctrl-C, a termination or the closing of its terminal, or after a given time."""

    seconds: float | None = None
    requested: bool = False
    began_at: float = 0.0

    @property
    def now(self) -> bool:
        """Whether the work is to end now."""
        return self.requested or (self.seconds is not None and self.elapsed_s >= self.seconds)

    @property
    def elapsed_s(self) -> float:
        """Seconds since the work began."""
        return monotonic() - self.began_at

    def request(self, number: int, at: FrameType | None) -> None:
        """Handle a signal: the first one requests the end, the second one raises `KeyboardInterrupt`.

        A hangup never raises, because a closing terminal and its shell may send one each.
        """
        if self.requested and number != _HANGUP:
            raise KeyboardInterrupt
        self.requested = True


@contextmanager
def stop_on_signal(seconds: float | None = None) -> Iterator[StopSignal]:
    """Turn the first Ctrl-C, termination or hangup during the block into a request, so that files are completed.

    A request cannot get lost, as a `KeyboardInterrupt` does that is raised where a library ignores errors. A hangup that is
    ignored, as under nohup, stays ignored. Outside the main thread no signal arrives, and nothing is changed.
    """
    stop = StopSignal(seconds, began_at=monotonic())
    if current_thread() is not main_thread():
        yield stop
        return
    numbers = [signal.SIGINT, signal.SIGTERM]
    if _HANGUP is not None and signal.getsignal(_HANGUP) is not signal.SIG_IGN:
        numbers.append(_HANGUP)
    before = {number: signal.signal(number, stop.request) for number in numbers}
    try:
        yield stop
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@dataclass
class StatusLine:
    """One line on standard error that is rewritten while a step lasts."""

    width: int = 100

    def print_title(self, title: str) -> None:
        """Print what to do now."""
        print(f"\n{title}", file=sys.stderr)

    def update(self, status: str) -> None:
        """Replace the text of the line."""
        print(f"\r  {printable_text(status)[: self.width]:<{self.width}}", end="", file=sys.stderr, flush=True)

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Keep the line while the block runs, and end it afterwards."""
        try:
            yield
        finally:
            print(file=sys.stderr)


class StepLine(StatusLine):
    """What is being done now, on standard error where that is a terminal; it is removed at the end."""

    def __enter__(self) -> "StepLine":
        return self

    def __exit__(self, *_: object) -> None:
        if sys.stderr.isatty():
            print(f"\r{'':{self.width + 2}}\r", end="", file=sys.stderr, flush=True)

    def show(self, step: str) -> None:
        """Replace the text of the line."""
        if sys.stderr.isatty():
            self.update(f"{step} …")


def calibration_json_dict(sensor: "SensorFolder") -> dict[str, object]:
    """Return the certificate and its checks for scripts."""
    import msgspec

    from ninedtact.calibration.certificate.checks import compute_certificate_checks, overall_check_level

    certificate = sensor.record.certificate
    assert certificate is not None
    return {
        "sensor": str(sensor.path),
        "id": sensor.id,
        "result": overall_check_level(certificate),
        "board": None,
        "ball": None,
        "warnings": [],
        "cause": None,
        **msgspec.to_builtins(certificate),
        "checks": [asdict(check) for check in compute_certificate_checks(certificate)],
    }


def format_calibration(sensor: "SensorFolder") -> Iterator[str]:
    """Yield the certificate in a few lines."""
    from ninedtact.calibration.certificate.checks import (
        certificate_headline,
        compute_certificate_checks,
        uses_in_words,
    )

    certificate = sensor.record.certificate
    assert certificate is not None
    yield f"sensor {sensor.id} calibrated: {sensor.path}   (± is one standard deviation)"
    if (board := certificate.board) is not None:
        yield (
            f"  board  {board.pins_found} of {board.pins_expected} pins, leave-one-out error {board.leave_one_out_rms_mm:.3f} mm "
            f"(the paper's method: {board.published_method_rms_mm:.3f} mm)"
        )
        yield f"  scale  {board.mm_per_px:.5f} ± {board.mm_per_px_std:.5f} mm per pixel"
    else:
        yield f"  scale  {sensor.record.grid.mm_per_px:.5f} mm per pixel, with the imported rectification"
    if (ball := certificate.ball) is not None:
        twin = sensor.record.twin
        std = "" if twin is None else f" ± {twin.fit.parameters['depth_mm'].std:.2f}"
        base = ", on a base that is rigid by design" if twin is not None and twin.gel.has_rigid_base else ""
        yield (
            f"  ball   radius {ball.ball_radius_mm:g} mm, pressed {ball.max_indentation_mm:.2f}{std} mm deep, reconstructed to "
            f"{ball.reconstruction_mae_mm:.3f} mm, noise {ball.noise_mm:.4f} mm, method {ball.method}{base}"
        )
    for kind, second in certificate.second_presses.items():
        yield (
            f"  {kind.replace('_', ' ')} of radius {second.radius_mm:g} mm, pressed {second.max_indentation_mm:.2f} mm deep; with "
            f"it the depth of the first ball is {second.first_mm:.3f} ± {second.first_std_mm:.3f} mm; by its own image alone "
            f"{second.first_alone_mm:.3f} ± {second.first_std_alone_mm:.3f} mm ({second.first_deviation:.1f} of this ± away)"
        )
    yield from (f"  warning: {warning}" for warning in certificate.warnings)
    yield f"  {certificate_headline(certificate)}"
    if certificate.cause is not None:
        yield f"  {certificate.cause.sentence}"
    yield from (
        f"  {check.level} ({uses_in_words(check.affects)}): {check.text}"
        for check in compute_certificate_checks(certificate)
        if check.level != "pass"
    )
    yield f"  open {sensor.path / 'certificate.html'} in a browser"

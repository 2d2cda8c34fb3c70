"""ninedtact collect: training pairs of image and wrench from pressing, dragging and twisting objects by hand. Its terminal reads
single keys and shows how many pairs of which forces were saved, are missing, or are refused.
"""

import os
import select
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import tyro
from msgspec import Meta

from ninedtact.cli.record import require_new_recording_path
from ninedtact.cli.result_and_interrupt import given_or_recorded_sensor, print_notice, print_result, stop_on_signal
from ninedtact.cli.shared_options import (
    AboveZero,
    CameraDelayOption,
    CameraOption,
    CameraOptions,
    JsonOption,
)
from ninedtact.errors import OutputError
from ninedtact.recording.errors import require_recording_libraries
from ninedtact.source_addresses import (
    is_recording_address,
    is_twin_address,
    require_matching_force_source,
    source_in_real_time,
)
from ninedtact_train.collecting.pair_selection import CollectSettings

if TYPE_CHECKING:
    from numpy import ndarray as Array

    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.force_torque.sample_checks import SampleCheckSettings
    from ninedtact_train.collecting.collection_sources import CollectSetup
    from ninedtact_train.collecting.collector import Collector
    from ninedtact_train.collecting.pair_selection import SavedPairCounts

_BAR_SYMBOLS = "·▁▂▃▄▅▆▇█"
_KEY_HELP = "n next object   u undo last contact   t tare   q end"
_TERMINAL_PERIOD_S, _LOG_PERIOD_S = 0.2, 5.0
"""Between two updates of a terminal, and between two lines without one."""
_MISSING_SHOWN = 4
_USUAL_COLUMNS = 80
_READ_BYTES = 64


@contextmanager
def open_key_reader() -> Iterator[Callable[[], str]]:
    """Yield a function that returns what was typed since its last call, without waiting.

    At a terminal it reads single keys while the block runs, without one the characters of a pipe.
    """
    try:
        descriptor = sys.stdin.fileno()
    except (OSError, ValueError, AttributeError):  # no input at all, or one that a test took away
        yield str
        return

    is_open = True

    def read_keys() -> str:
        nonlocal is_open
        if not is_open or not select.select([descriptor], [], [], 0)[0]:
            return ""
        typed = os.read(descriptor, _READ_BYTES)
        is_open = bool(typed)
        return typed.decode(errors="ignore")

    if not os.isatty(descriptor):
        yield read_keys
        return
    import termios
    import tty

    before = termios.tcgetattr(descriptor)
    tty.setcbreak(descriptor)
    try:
        yield read_keys
    finally:
        with suppress(termios.error):
            termios.tcsetattr(descriptor, termios.TCSADRAIN, before)


class CollectTerminalDisplay:
    """Updates a few lines on standard error at a terminal; prints one line now and then elsewhere."""

    def __init__(self) -> None:
        self._is_terminal = sys.stderr.isatty()
        self._height, self._due_at = 0, 0.0
        self._message = ""

    def show_message(self, text: str) -> None:
        """Show a message at once, and keep it on the screen."""
        self._message = text
        if not self._is_terminal:
            print(f"ninedtact: {text}", file=sys.stderr, flush=True)

    def show(self, collector: "Collector", at_once: bool = False) -> None:
        """Show the progress if it is time, or at once."""
        if monotonic() < self._due_at and not at_once:
            return
        self._due_at = monotonic() + (_TERMINAL_PERIOD_S if self._is_terminal else _LOG_PERIOD_S)
        if not self._is_terminal:
            print(collect_progress_line(collector), file=sys.stderr, flush=True)
            return
        missing = _missing_line(collector.counts)
        lines = [collect_progress_line(collector), *histogram_lines(collector), missing, self._message, _KEY_HELP]
        up = f"\x1b[{self._height}A\x1b[J" if self._height else ""
        print(up + "\n".join(lines), file=sys.stderr, flush=True)
        columns = _terminal_columns()
        self._height = sum(max(-(-len(line) // columns), 1) for line in lines)  # a terminal wraps long lines


def _terminal_columns() -> int:
    try:
        return os.get_terminal_size(sys.stderr.fileno()).columns or _USUAL_COLUMNS
    except (OSError, ValueError):
        return _USUAL_COLUMNS


def collect_progress_line(collector: "Collector") -> str:
    """Return the present object, the number of pairs, and what is wrong, as one line."""
    kinds = collector.counts.kinds
    numbers = f"{kinds['rule']} by rule, {kinds['light_touch']} light, {kinds['no_contact']} without contact"
    line = f"{collector.object or '-'}: {len(collector.counts.pairs)} pairs ({numbers})"
    if collector.tare_in_progress is not None:
        return f"{line}; taring: {collector.tare_advice}"
    if collector.fault is not None:
        return f"{line}; NOT SAVING: {collector.fault_text(collector.fault)}"
    return f"{line}; refused {collector.rejected.total()}"


def histogram_lines(collector: "Collector") -> list[str]:
    """Return one line for each axis: its range, a bar for each bin, and the present value."""
    from ninedtact.quantities import DISPLAY_FACTORS, DISPLAY_UNITS, WRENCH_AXES

    low, high = collector.counts.limits * DISPLAY_FACTORS
    now = collector.newest.wrench.six * DISPLAY_FACTORS if collector.newest is not None else low * 0
    lines, counts = [], collector.counts.counts
    for axis in range(6):
        digits = 2 if axis < 3 else 1
        limits = [f"{limit[axis]:+6.{digits}f}" for limit in (low, high)]
        bars = _bars(counts[axis])
        lines.append(
            f"  {WRENCH_AXES[axis]} {limits[0]} {bars} {limits[1]} {DISPLAY_UNITS[axis]:4} now {now[axis]:+8.{digits + 1}f}"
        )
    return lines


def _bars(counts: "Array") -> str:
    """Return a row of numbers as a row of bars; a dot is zero."""
    most = max(int(counts.max()), 1)
    return "".join(_BAR_SYMBOLS[-(-int(count) * (len(_BAR_SYMBOLS) - 1) // most)] for count in counts)


def _missing_line(counts: "SavedPairCounts") -> str:
    ranges = counts.missing_ranges()
    more = f" and {len(ranges) - _MISSING_SHOWN} more" if len(ranges) > _MISSING_SHOWN else ""
    return f"  missing: {', '.join(ranges[:_MISSING_SHOWN])}{more}" if ranges else "  every range has pairs"


@dataclass(frozen=True)
class CollectCommand:
    """Collect training pairs: press, drag and twist objects by hand.

    A pair of image and wrench is saved automatically whenever its wrench differs from all that were saved in the same contact.
    Leave the skin untouched for the first seconds. Keys: n next object, u undo the last contact, t tare, q end.
    """

    source: str
    """Camera (0, /dev/video0, usb:1-2, csi:0) or stream; a recording (.mcap); or sim, the twin of the sensor, pressed by a
    script."""
    force_torque: str
    """Force/torque sensor under the tactile one (bota:CONFIG, netft:HOST, onrobot:HOST, serial:PORT); a recording if the source
    is one; sim if the source is sim."""
    out: Path
    """Recording to write: a new .mcap file. Each pair is on disk when it is counted."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote; it is attached to the recording. A recording brings its own."""
    objects: tuple[str, ...] = ()
    """Names of the objects in turn (key n); after the last, object_001, object_002 and so on. With sim: ball:4, gear_07, …"""
    pairs: Annotated[int, Meta(ge=1)] | None = None
    """Number of pairs after which to end."""
    seconds: AboveZero | None = None
    """Time after which to end; without it, key q, Ctrl-C or the end of the source ends the collection."""
    camera_delay_ms: CameraDelayOption = 0.0
    settings: Annotated[CollectSettings, tyro.conf.arg(name="")] = CollectSettings()
    touches: Annotated[int, Meta(ge=1)] = 3
    """Number of times that the script presses each object; with sim only."""
    seed: Annotated[int, Meta(ge=0)] | None = None
    """Seed of the load below which the first pair of each contact is saved, and of the script; without it, random."""
    camera: CameraOption = CameraOptions()
    json: JsonOption = False

    def run(self) -> int:
        """Collect pairs and print their numbers; raises what a lost device raises, every pair kept."""
        require_recording_libraries()
        require_new_recording_path(self.out)
        require_matching_force_source(self.source, self.force_torque, is_twin_address, is_recording_address)
        screen = CollectTerminalDisplay()
        with given_or_recorded_sensor(self.sensor, self.source) as folder:
            setup = self._setup(folder, self.settings.checks, screen)
            collector = self._collect(folder, setup, self._resolve_camera_delay_ms(folder, setup), screen)
        return print_result(self.json, _to_json_dict(self.out, collector), _summary_lines(self.out, collector))

    def _setup(
        self, folder: "SensorFolder", checks: "SampleCheckSettings", screen: CollectTerminalDisplay
    ) -> "CollectSetup":
        from ninedtact.capture.force_torque.wrench_source_from_address import force_torque_sensor_for
        from ninedtact_train.collecting.collection_sources import (
            build_simulated_collect_setup,
            collection_setup_from_devices,
            collection_setup_from_recordings,
        )

        if is_twin_address(self.source):
            return build_simulated_collect_setup(folder, self.objects, self.touches, self.seed or 0, checks)
        if is_recording_address(self.source):
            images, wrenches = Path(self.source).expanduser(), Path(self.force_torque).expanduser()
            return collection_setup_from_recordings(images, wrenches, checks, folder.record.design.force_torque)
        camera = source_in_real_time(self.source, self.camera.settings(), sensor=folder)
        device = force_torque_sensor_for(self.force_torque)
        return collection_setup_from_devices(camera, device, folder, checks, screen.show_message)

    def _resolve_camera_delay_ms(self, folder: "SensorFolder", setup: "CollectSetup") -> float:
        """Return the delay to subtract, which is zero where a recording's stamps have one subtracted; raises `OutputError`."""
        from ninedtact.capture.camera_delay import SAVED, resolve_camera_delay_ms

        given, subtracted = self.camera_delay_ms, f"{setup.camera_delay_ms:g} ms subtracted"
        if given == 0 or setup.camera_delay_ms == 0:
            return resolve_camera_delay_ms(given, folder.path, setup.camera_name)
        if given != SAVED:
            raise OutputError(
                expected=f"no --camera-delay-ms for {self.source}, whose stamps already have {subtracted}",
                got=f"{given}",
                remedy="drop it",
            )
        print_notice(f"the stamps of {self.source} already have {subtracted}; the saved delay is not subtracted again")
        return 0.0

    def _collect(
        self, folder: "SensorFolder", setup: "CollectSetup", camera_delay_ms: float, screen: CollectTerminalDisplay
    ) -> "Collector":
        from ninedtact.recording.recorder import notify_partial_recording
        from ninedtact_train.collecting.collector import collect_pairs

        def should_stop(collector: "Collector") -> bool:
            has_enough = self.pairs is not None and len(collector.counts.pairs) >= self.pairs
            return until.now or has_enough or not handle_collect_keys(read_keys(), collector, screen)

        with (
            stop_on_signal(self.seconds) as until,
            notify_partial_recording(self.out, print_notice),
            open_key_reader() as read_keys,
        ):
            collector = collect_pairs(
                setup,
                self.out,
                folder,
                self.settings,
                self.objects,
                self.seed,
                camera_delay_ms,
                should_stop,
                notify=screen.show_message,
                on_progress=screen.show,
            )
            screen.show(collector, at_once=True)
        return collector


def handle_collect_keys(typed: str, collector: "Collector", screen: CollectTerminalDisplay) -> bool:
    """Do what the keys ask for; return whether to continue."""
    for key in typed.lower():
        if key == "q":
            return False
        if key == "n":
            collector.begin_object()
            screen.show_message(f"next object: {collector.object}")
        elif key == "u":
            screen.show_message(collector.undo_last_contact())
        elif key == "t":
            collector.begin_tare()
            screen.show_message("tare: do not touch the gel")
    return True


def _to_json_dict(out: Path, collector: "Collector") -> dict[str, Any]:
    from ninedtact.quantities import WRENCH_AXES

    counts = collector.counts
    return {
        "out": str(out),
        "id": collector.writer.metadata.id,
        "pairs": len(counts.pairs),
        "kinds": dict(counts.kinds),
        "objects": dict(counts.objects),
        "refused": {fault.name.lower(): number for fault, number in collector.rejected.items()},
        "counts": {axis: row.tolist() for axis, row in zip(WRENCH_AXES, counts.counts, strict=True)},
        "missing": counts.missing_ranges(),
    }


def _summary_lines(out: Path, collector: "Collector") -> Iterator[str]:
    counts = collector.counts
    yield f"{out}: {len(counts.pairs)} pairs, {out.stat().st_size / 1e6:.1f} MB"
    yield f"  {', '.join(f'{number} {kind}' for kind, number in counts.kinds.items())}"
    yield from (f"  {number:8d}  {name}" for name, number in counts.objects.items())
    for fault, number in collector.rejected.items():
        yield f"  {number} images not saved: {collector.fault_text(fault)}"

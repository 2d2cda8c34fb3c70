"""ninedtact collect: pairs of image and wrench from pressing, dragging and twisting objects by hand."""

import json
from collections.abc import Iterator
from contextlib import closing
from dataclasses import asdict, dataclass
from itertools import chain, count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from ninedtact.cli.collect_screen import Screen, keys
from ninedtact.cli.collect_setup import Bench, devices, recording, twin
from ninedtact.cli.devices import is_recording, is_sim, require_alike, sensor_of
from ninedtact.cli.options import CollectOptions
from ninedtact.cli.record import require_new_recording, require_seconds
from ninedtact.cli.terminal import print_result, stop_on_signal
from ninedtact.errors import NinedtactError

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.recording.collecting.collector import Collector
    from ninedtact.recording.collecting.settings import CollectSettings
    from ninedtact.recording.merge_streams import MergedArrival
    from ninedtact.recording.metadata import RecordingMetadata


class CollectImpossible(NinedtactError):
    """A collection of nothing."""


@dataclass(frozen=True)
class Collect:
    """Collect pairs: press, drag and twist objects by hand.

    A pair of image and wrench is saved by itself whenever the wrench differs from all that were saved in the same contact.
    Leave the skin untouched for the first seconds. Keys: n next object, u undo the last contact, t tare, q end.
    """

    source: str
    """Camera (0, /dev/video0, csi:0) or stream; a recording (.mcap); or sim, the sensor's twin under a scripted hand."""
    force_torque: str
    """Force/torque sensor under the tactile one (bota:CONFIG, netft:HOST, onrobot:HOST, serial:PORT); a recording with a
    recording; sim with sim."""
    out: Path
    """The episode: a new .mcap file. Each pair is on disk when it is counted."""
    sensor: Path | None = None
    """Sensor folder that `ninedtact calibrate` wrote; it rides along in the file. A recording brings its own."""
    objects: tuple[str, ...] = ()
    """Names of the objects in turn (key n); after the last, object_001, object_002 and so on. With sim: ball:4, gear_07, …"""
    pairs: int | None = None
    """End after so many."""
    seconds: float | None = None
    """End after this time; without it, at key q, Ctrl-C or the end of the source."""
    options: Annotated[CollectOptions, tyro.conf.arg(name="")] = CollectOptions()
    touches: int = 3
    """With sim: how often the scripted hand presses each object."""
    seed: int | None = None
    """Of the load below which each contact's first pair is saved, and of the scripted hand; without it, another each time."""
    automatic: bool = False
    """Leave the camera's automatic exposure and white balance on, for one that cannot switch them off."""
    json: bool = False
    """Print the figures as one JSON object."""

    def run(self) -> int:
        """Collect, and say what there is; raises what a lost device raises, every pair kept."""
        from ninedtact.recording.errors import require_recording_libraries

        require_recording_libraries()
        require_new_recording(self.out)
        require_seconds(self.seconds)
        require_alike(self.source, self.force_torque, is_sim, is_recording)
        require_pairs(self.pairs, self.touches)
        settings = self.options.settings()
        screen = Screen()
        with sensor_of(self.sensor, self.source) as folder:
            bench = self.bench(folder, settings, screen)
            collector = self.collected(folder, settings, bench, screen)
        return print_result(self.json, figures(self.out, collector), lines(self.out, collector))

    def bench(self, folder: "SensorFolder", settings: "CollectSettings", screen: Screen) -> Bench:
        """What was named, not yet opened."""
        from ninedtact.capture.frame_source import DEFAULT_CAMERA, FIXED_EXPOSURE

        if is_sim(self.source):
            return twin(folder, self.objects, self.touches, self.seed or 0, settings.trust)
        if is_recording(self.source):
            return recording(self.source, self.force_torque, settings.trust)
        camera = DEFAULT_CAMERA if self.automatic else FIXED_EXPOSURE
        return devices(self.source, self.force_torque, folder, settings.trust, camera, screen.remark)

    def collected(
        self, folder: "SensorFolder", settings: "CollectSettings", bench: Bench, screen: Screen
    ) -> "Collector":
        """The collector at its end, its episode finished."""
        import numpy as np

        from ninedtact.recording.collecting.collector import COLLECTED_TOPICS, Collector
        from ninedtact.recording.reader import sensor_folder_attachments
        from ninedtact.recording.writer import RecordingWriter

        session = self.session(folder, settings, bench)
        episode = RecordingWriter(self.out, session, COLLECTED_TOPICS, sensor_folder_attachments(folder.path))
        names = chain(self.objects, (f"object_{number:03d}" for number in count(1)))
        collector = Collector(episode, settings, names, np.random.default_rng(self.seed))
        with stop_on_signal(self.seconds) as until, episode, keys() as typed, closing(bench.feed()) as feed:
            for fed in feed:
                if until.now or self.has_enough(collector) or not obeyed(typed.pressed(), collector, screen):
                    break
                hand_over(fed, collector, bench)
                screen.show(collector)
            collector.end()
            screen.show(collector, at_once=True)
        return collector

    def has_enough(self, collector: "Collector") -> bool:
        """Whether as many pairs were saved as were asked for."""
        return self.pairs is not None and len(collector.counters.saved) >= self.pairs

    def session(self, folder: "SensorFolder", settings: "CollectSettings", bench: Bench) -> "RecordingMetadata":
        """What is said once."""
        from importlib.metadata import version

        from ninedtact.recording.metadata import RecordingMetadata, wall_minus_monotonic_ns

        ahead_ns = bench.wall_minus_monotonic_ns
        return RecordingMetadata(
            sensor=folder.id,
            purpose="collect",
            source=bench.camera.name,
            force_torque=bench.force_torque.name,
            settings=json.dumps(asdict(settings)),
            software=version("ninedtact"),
            wall_minus_monotonic_ns=wall_minus_monotonic_ns() if ahead_ns is None else ahead_ns,
        )


def require_pairs(pairs: int | None, touches: int) -> None:
    """Refuse a collection of nothing; raises `CollectImpossible`."""
    if pairs is not None and pairs < 1:
        raise CollectImpossible(f"expected --pairs of at least 1, got {pairs}; drop it to collect until q")
    if touches < 1:
        raise CollectImpossible(f"expected --touches of at least 1, got {touches}; drop it")


def obeyed(typed: str, collector: "Collector", screen: Screen) -> bool:
    """Do what the keys say; whether to go on."""
    for key in typed.lower():
        if key == "q":
            return False
        if key == "n":
            collector.next_object()
            screen.remark(f"next object: {collector.object}")
        elif key == "u":
            screen.remark(collector.undo())
        elif key == "t":
            collector.tare()
            screen.remark("tare: leave the skin untouched")
    return True


def hand_over(fed: "MergedArrival", collector: "Collector", bench: Bench) -> None:
    """Give the collector what came."""
    from ninedtact.quantities import Frame

    if bench.was_away.is_set():
        bench.was_away.clear()
        collector.trust.doubt_zero()
    if fed is None:
        return
    if isinstance(fed.item, Frame) and bench.object_at is not None:
        name = bench.object_at(fed.item)
        if name != collector.object:
            collector.next_object(name, fed.item.stamp_ns)
    collector.hear(fed)


def figures(out: Path, collector: "Collector") -> dict[str, Any]:
    """What there is."""
    from ninedtact.recording.collecting.pair_counts import AXES

    counters = collector.counters
    return {
        "out": str(out),
        "session": collector.episode.session.id,
        "pairs": len(counters.saved),
        "kinds": dict(+counters.kinds),
        "objects": dict(+counters.objects),
        "refused": {fault.name.lower(): number for fault, number in collector.refused.items()},
        "counts": {axis: row.tolist() for axis, row in zip(AXES, counters.counts, strict=True)},
        "missing": counters.missing(),
    }


def lines(out: Path, collector: "Collector") -> Iterator[str]:
    """The same for a person."""
    counters = collector.counters
    yield f"{out}: {len(counters.saved)} pairs, {out.stat().st_size / 1e6:.1f} MB"
    yield f"  {', '.join(f'{number} {kind}' for kind, number in counters.kinds.items() if number)}"
    yield from (f"  {number:8d}  {name}" for name, number in counters.objects.items() if number)
    for fault, number in collector.refused.items():
        yield f"  {number} images not saved: {collector.sentence(fault)}"

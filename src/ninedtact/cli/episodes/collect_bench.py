"""The devices of a collection: a camera and a force/torque sensor that are read together."""

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING

from ninedtact.cli.devices import device, live_source
from ninedtact.cli.episodes.scripted_hand import scripted_hand

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.force_torque.trusted import TrustSettings
    from ninedtact.capture.settings import CameraSettings
    from ninedtact.capture.source import FrameSource
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.quantities import Frame
    from ninedtact.recording.collecting.feed import Fed


@dataclass(frozen=True)
class Bench:
    """Two sources that belong together, not yet opened."""

    camera: "FrameSource"
    force_torque: "WrenchSource"
    """Its untrusted samples are refused; its tare is not taken off."""
    is_live: bool = True
    object_at: "Callable[[Frame], str] | None" = None
    """Which object is in the hand, where that is known without a key."""
    was_away: Event = field(default_factory=Event)
    """Set when a force/torque sensor is back that was lost."""
    wall_minus_monotonic_ns: int | None = None
    """Of a recording's stamps."""

    def feed(self) -> "Generator[Fed, None, None]":
        """Images and samples, in one stream; opens both."""
        from ninedtact.recording.collecting.feed import in_turn, live

        return live(self.camera, self.force_torque) if self.is_live else in_turn(self.camera, self.force_torque)


def devices(
    source: str,
    force_torque: str,
    folder: "SensorFolder",
    trust: "TrustSettings",
    camera: "CameraSettings",
    say: Callable[[str], None],
) -> Bench:
    """A camera and a force/torque sensor on the desk."""
    from ninedtact.capture.force_torque.mounted import Mounted
    from ninedtact.capture.force_torque.trusted import Trusted

    was_away = Event()

    def back() -> None:
        was_away.set()
        say("the force/torque sensor is back")

    opened = Trusted(device(force_torque, lambda loss: say(f"{loss}; waiting for it"), back), trust)
    mounted = Mounted(opened, folder.record.design.force_torque)
    return Bench(live_source(source, camera), mounted, was_away=was_away)


def recording(source: str, force_torque: str, trust: "TrustSettings") -> Bench:
    """The images and the wrenches of recordings, with their own stamps."""
    from ninedtact.capture.force_torque.trusted import Trusted
    from ninedtact.recording.replay import Replay, ReplayedWrenches
    from ninedtact.recording.stored import Episode

    images, samples = (Path(text).expanduser() for text in (source, force_torque))
    with Episode(images) as episode:
        ahead_ns = episode.session.wall_minus_monotonic_ns
    forces = Trusted(ReplayedWrenches(samples), trust)
    return Bench(Replay(images), forces, is_live=False, wall_minus_monotonic_ns=ahead_ns)


def twin(folder: "SensorFolder", objects: tuple[str, ...], touches: int, seed: int, trust: "TrustSettings") -> Bench:
    """The sensor's twin under a scripted hand."""
    from ninedtact.calibration.twin.sensor_twin import twin_of
    from ninedtact.capture.force_torque.trusted import Trusted

    hand = scripted_hand(twin_of(folder), objects, touches, seed)
    camera, force_torque = hand.sources
    return Bench(camera, Trusted(force_torque, trust), is_live=False, object_at=hand.object_at)

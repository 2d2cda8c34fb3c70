"""A sensor that is read in real time, as the live page shows it and other programs receive it."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ninedtact.open_sensor import PathLike, assemble_sensor
from ninedtact.source_addresses import is_twin_address, source_in_real_time

if TYPE_CHECKING:
    from ninedtact.calibration.sensor_folder import SensorFolder
    from ninedtact.capture.frame_source import CameraSettings, FrameSource
    from ninedtact.capture.wrench_source import WrenchSource
    from ninedtact.force.estimator_and_scale import ForceEstimator
    from ninedtact.sensor import Sensor
    from ninedtact.simulation.press_sequence import PressSequence
    from ninedtact.simulation.simulated_sources import DemoSources


@dataclass(frozen=True)
class LiveSensor:
    """A sensor that is read in real time, not yet opened; of a twin with its true wrench and its simulation."""

    sensor: "Sensor"
    true_wrench: "WrenchSource | None" = None
    simulation: "PressSequence | None" = None


def assemble_live_sensor(
    folder: "SensorFolder",
    source: "str | DemoSources",
    references: Sequence[PathLike] = (),
    settings: "CameraSettings | None" = None,
    follow_reference: bool = True,
    loop: bool = False,
    estimator: "str | ForceEstimator" = "none",
    name: str = "",
    notify: Callable[[str], None] = lambda sentence: None,
) -> LiveSensor:
    """Return a sensor that is read in real time, as the live page shows it and other programs receive it; not yet opened.

    source: an address, or the simulated sources of a twin. A camera that is lost is waited for. Files and recordings play at their
    own pace, a recording with the reference image that it starts with; loop: again and again. follow_reference: whether the
    reference image of a live source follows slow changes. name: of the sensor among several, each of whose twins has noise of its
    own. notify: receives a sentence about a camera that is lost or is back. The other parameters, and what is raised, are those of
    `open`.
    """
    from ninedtact.capture.frame_pacing import LatestFrameSource
    from ninedtact.capture.frame_source import FIXED_EXPOSURE
    from ninedtact.capture.reconnecting import ReconnectingFrameSource, RepeatingSource

    of = f"{name}: " if name else ""
    follow = None if follow_reference else False
    if isinstance(source, str) and is_twin_address(source):
        from ninedtact.simulation.simulated_sources import demo_sources

        source = demo_sources(folder.twin().with_noise_of(name))
    if not isinstance(source, str):
        frames: FrameSource = source.camera
    else:
        played = source_in_real_time(
            source, settings or FIXED_EXPOSURE, lambda sentence: notify(f"{of}{sentence}"), folder
        )
        frames = ReconnectingFrameSource(
            RepeatingSource(played) if loop else played,
            on_lost=lambda loss: notify(f"{of}{loss}; waiting for it"),
            on_back=lambda: notify(f"{of}it is back"),
        )
    chosen = folder.estimator(estimator) if isinstance(estimator, str) else estimator
    sensor = assemble_sensor(folder, LatestFrameSource(frames), chosen, references, follow)
    return LiveSensor(sensor) if isinstance(source, str) else LiveSensor(sensor, source.force_torque, source.simulation)

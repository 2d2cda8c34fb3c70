"""The measured wrench: a device with all that makes its samples fit to be kept."""

from collections.abc import Callable
from dataclasses import dataclass

from ninedtact.capture.force_torque.mounted import Mounted
from ninedtact.capture.force_torque.reopening import Reopening
from ninedtact.capture.force_torque.tared import Tared, TareSettings
from ninedtact.capture.force_torque.trusted import Trusted, TrustSettings
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource
from ninedtact.design import ForceTorqueMount


@dataclass(frozen=True)
class MeasuredSettings:
    """What is believed of the device, and how it is tared."""

    trust: TrustSettings = TrustSettings()
    tare: TareSettings = TareSettings()


def measured(
    device: WrenchSource,
    mount: ForceTorqueMount,
    on_lost: Callable[[WrenchSensorLost], None],
    on_back: Callable[[], None] = lambda: None,
    settings: MeasuredSettings = MeasuredSettings(),
) -> Tared:
    """What the object applies to the skin, in the sensor frame: trusted samples only, tared at opening, reopened when lost."""
    trusted = Trusted(Reopening(device, on_lost, on_back), settings.trust)
    return Tared(Mounted(trusted, mount), settings.tare)

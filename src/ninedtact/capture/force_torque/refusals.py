"""What goes wrong with a force/torque sensor, beside its loss (`WrenchSensorLost`)."""

from ninedtact.errors import NinedtactError


class WrenchSensorNotFound(NinedtactError):
    """No force/torque sensor could be opened there."""


class ForceTorqueLibraryMissing(NinedtactError):
    """The library that speaks with this device is not installed."""

    def __init__(self, name: str, package: str) -> None:
        super().__init__(
            f"expected {package} for {name}, got no such package; run pip install 'ninedtact[force-torque]'"
        )


class WrenchUntrusted(NinedtactError):
    """One sample that must not be used. The source stays open, and the next read goes on with the next sample."""


class WrenchSaturated(WrenchUntrusted):
    """The load is beyond what the device can measure."""


class WrenchFrozen(WrenchUntrusted):
    """The device repeats one sample."""


class WrenchJumped(WrenchUntrusted):
    """The reading leapt as no load does."""


class WrenchFaulty(WrenchUntrusted):
    """The device itself says that this sample is wrong, or it is not a number."""

"""Force/torque sensors that stream RDT records over UDP, through pynetft: ATI Net F/T and Axia, OnRobot HEX.

A record holds counts. An ATI device tells over HTTP what a count is worth; an OnRobot one does not, and has fixed counts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.capture.force_torque.sensor import RECEIVE_TIMEOUT_S, ForceTorqueDriver, ForceTorqueSample
from ninedtact.capture.wrench_source import (
    ForceTorqueLibraryMissing,
    WrenchFaulty,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSensorLost,
    WrenchSensorNotFound,
)

if TYPE_CHECKING:
    import pynetft

RDT_PORT, HTTP_PORT = 49152, 80
FIRST_SAMPLE_S = 2.0
RETRY_S = 0.05, 0.2
"""pynetft hangs up at every record with an error status, saturation included, and calls again after this long."""
KEPT_RECORDS = 256
N_PER_UNIT = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665}
NM_PER_UNIT = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
    "kgf-cm": 0.0980665,
}


@dataclass(frozen=True)
class CountScale:
    """What a count of a device is worth that does not tell it."""

    per_n: float
    per_nm: float


@dataclass(frozen=True)
class DeviceVariant:
    """How one maker's devices differ."""

    counts: CountScale | None
    """None: the device tells over HTTP."""
    saturated: int
    """Bits of the status that say so."""
    harmless: tuple[int, ...] = (0,)
    """Statuses of a good sample."""


ATI = DeviceVariant(None, saturated=0x0002_0000, harmless=(0, 0x8001_0000))
"""Bit 17: transducer saturation. 8001 0000: a threshold that somebody set on the device was passed (docs/force_torque.md)."""
ONROBOT = DeviceVariant(CountScale(per_n=10_000, per_nm=100_000), saturated=0)
"""The default counts of its maker's example; what its status bits mean is not public, so any is a fault."""


class NetFtDriver(ForceTorqueDriver):
    """A device by its host name or address."""

    def __init__(
        self, name: str, host: str, dialect: DeviceVariant = ATI, rdt_port: int = RDT_PORT, http_port: int = HTTP_PORT
    ) -> None:
        self.name = name
        self._host, self._ports, self._dialect = host, (rdt_port, http_port), dialect
        self._client: pynetft.Client

    def connect(self) -> None:
        """Ask for the stream, and see one record."""
        try:
            import pynetft
        except ImportError as absence:
            raise ForceTorqueLibraryMissing(self.name, "pynetft") from absence
        client = pynetft.Client(self._config(), queue_size=KEPT_RECORDS)
        try:
            client.start()
            cause = None if client.wait_for_first_sample(FIRST_SAMPLE_S) else client.health().last_error or "silence"
        except pynetft.NetFTError as trouble:
            cause = str(trouble)
        if cause is not None:
            client.stop()
            raise WrenchSensorNotFound(
                f"expected RDT records from {self._host}, got: {cause}; check its address, its power and that no other "
                "program listens to it"
            )
        self._client, self._records = client, client.samples(RECEIVE_TIMEOUT_S)

    def receive(self) -> Sequence[ForceTorqueSample]:
        """The next record; pynetft's own thread stamped it when it came."""
        try:
            return [self._sample(next(self._records))]
        except TimeoutError:
            self._records = self._client.samples(RECEIVE_TIMEOUT_S)
            return []
        except StopIteration:
            raise WrenchSensorLost(f"expected a sample from {self.name}, got its end; open it again") from None

    def disconnect(self) -> None:
        """Stop the stream."""
        self._client.stop()

    def _config(self) -> "pynetft.Config":
        import pynetft

        counts = self._dialect.counts
        return pynetft.Config(
            self._host,
            *self._ports,
            reconnect_initial_delay=RETRY_S[0],
            reconnect_max_delay=RETRY_S[1],
            deliver_samples_with_error_status=True,
            calibration_override=None
            if counts is None
            else pynetft.Calibration(
                counts.per_n, counts.per_nm, pynetft.ForceUnit.NEWTON, pynetft.TorqueUnit.NEWTON_METER
            ),
        )

    def _sample(self, record: "pynetft.ForceTorqueSample") -> ForceTorqueSample:
        force, torque = N_PER_UNIT.get(record.force_unit), NM_PER_UNIT.get(record.torque_unit)
        flaw = self._flaw(record.status)
        if force is None or torque is None:
            units = f"{record.force_unit.value} and {record.torque_unit.value}"
            flaw = WrenchFaulty(f"expected units of {self.name} that are known, got {units}; set N and N-m on it")
        six = np.concatenate([np.array(record.force) * (force or np.nan), np.array(record.torque) * (torque or np.nan)])
        return ForceTorqueSample(six, record.received_at_ns, record.rdt_sequence, flaw)

    def _flaw(self, status: int) -> WrenchSampleRejected | None:
        if status in self._dialect.harmless:
            return None
        if status & self._dialect.saturated:
            return WrenchSaturated(
                f"expected a load that {self.name} can measure, got saturation (status {status:08x}); press less"
            )
        return WrenchFaulty(
            f"expected status 0 from {self.name}, got {status:08x}; look it up in the device's manual, then switch it off "
            "and on"
        )

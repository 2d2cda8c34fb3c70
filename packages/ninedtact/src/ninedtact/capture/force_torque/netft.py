"""Driver for force/torque sensors that stream RDT records over UDP, through pynetft: ATI Net F/T and Axia, OnRobot HEX.

A record holds counts. An ATI device reports over HTTP how many counts a newton has; an OnRobot device has fixed counts.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ninedtact.capture.force_torque.driver_source import RECEIVE_TIMEOUT_S, ForceTorqueDriver, ForceTorqueSample
from ninedtact.capture.wrench_source import WrenchSensorLost
from ninedtact.errors import DeviceError, InputError
from ninedtact.required_libraries import require_libraries

if TYPE_CHECKING:
    import pynetft

_RDT_PORT, _HTTP_PORT, _HIGHEST_PORT = 49152, 80, 65_535
_FIRST_SAMPLE_S = 2.0
_RETRY_S = 0.05, 0.2
"""Time after which pynetft reconnects; it disconnects at every record with an error status, saturation included."""
_KEPT_RECORDS = 256
_N_PER_UNIT = {"N": 1.0, "kN": 1e3, "lbf": 4.4482216152605, "klbf": 4448.2216152605, "kgf": 9.80665}
_NM_PER_UNIT = {
    "N-m": 1.0,
    "N-mm": 1e-3,
    "kN-m": 1e3,
    "lbf-in": 0.1129848290276167,
    "lbf-ft": 1.3558179483314004,
    "kgf-cm": 0.0980665,
}


@dataclass(frozen=True)
class _DeviceVariant:
    """The properties in which the devices of one manufacturer differ from others."""

    counts: tuple[float, float] | None
    """Counts per newton and per newton metre; None where the device reports them over HTTP."""
    saturated: int
    """Bits of the status that mark a saturated sample."""
    harmless: tuple[int, ...] = (0,)
    """Status words of a good sample."""


ATI = _DeviceVariant(None, saturated=0x0002_0000, harmless=(0, 0x8001_0000))
"""Bit 17: transducer saturation. 8001 0000: a threshold set on the device was passed (docs/force_torque.md)."""
ONROBOT = _DeviceVariant((10_000, 100_000), saturated=0)
"""The default counts of the manufacturer's example; the status bits are not documented, so any set bit counts as a fault."""


class NetFtDriver(ForceTorqueDriver):
    """The driver of a device on the network, named by its host name or address."""

    def __init__(
        self,
        name: str,
        host: str,
        variant: _DeviceVariant = ATI,
        rdt_port: int = _RDT_PORT,
        http_port: int = _HTTP_PORT,
    ) -> None:
        self.name = name
        self._host, self._ports, self._variant = host, (rdt_port, http_port), variant
        self._client: pynetft.Client

    @classmethod
    def from_address(cls, address: str) -> "NetFtDriver":
        """Return the driver of netft:HOST, or of onrobot:HOST, each with :PORT where it is another one; raises `InputError`."""
        kind, _, rest = address.partition(":")
        found = re.fullmatch(r"([A-Za-z0-9.-]+)(?::(\d{1,5}))?", rest)
        port = int(found[2] or _RDT_PORT) if found else 0
        if not found or not 0 < port <= _HIGHEST_PORT:
            raise InputError(expected="HOST or HOST:PORT after the colon", got=f"'{address}'", remedy="correct it")
        return cls(address, found[1], ONROBOT if kind == "onrobot" else ATI, port)

    def connect(self) -> None:
        """Request the stream and wait for one record; raises `DeviceError` or `MissingLibraryError`."""
        require_libraries("force-torque", "pynetft")
        import pynetft

        client = pynetft.Client(self._config(), queue_size=_KEPT_RECORDS)
        try:
            client.start()
            cause = None if client.wait_for_first_sample(_FIRST_SAMPLE_S) else client.health().last_error or "silence"
        except pynetft.NetFTError as trouble:
            cause = str(trouble)
        if cause is not None:
            client.stop()
            raise DeviceError(
                f"expected RDT records from {self._host}, got: {cause}; check its address, its power and that no other "
                "program listens to it"
            )
        self._client, self._records = client, client.samples(RECEIVE_TIMEOUT_S)

    def receive(self) -> Sequence[ForceTorqueSample]:
        """Return the next record, which the thread of pynetft stamped on arrival."""
        try:
            return [self._sample(next(self._records))]
        except TimeoutError:
            self._records = self._client.samples(RECEIVE_TIMEOUT_S)
            return []
        except StopIteration:
            raise WrenchSensorLost(
                expected=f"a sample from {self.name}", got="its end", remedy="open it again"
            ) from None

    def disconnect(self) -> None:
        """Stop the stream of records."""
        self._client.stop()

    def _config(self) -> "pynetft.Config":
        import pynetft

        counts = self._variant.counts
        return pynetft.Config(
            self._host,
            *self._ports,
            reconnect_initial_delay=_RETRY_S[0],
            reconnect_max_delay=_RETRY_S[1],
            deliver_samples_with_error_status=True,
            calibration_override=None
            if counts is None
            else pynetft.Calibration(*counts, pynetft.ForceUnit.NEWTON, pynetft.TorqueUnit.NEWTON_METER),
        )

    def _sample(self, record: "pynetft.ForceTorqueSample") -> ForceTorqueSample:
        force, torque = _N_PER_UNIT.get(record.force_unit), _NM_PER_UNIT.get(record.torque_unit)
        is_saturated, fault = bool(record.status & self._variant.saturated), ""
        if record.status not in self._variant.harmless and not is_saturated:
            fault = f"status {record.status:08x}; look it up in the device's manual, then switch it off and on"
        if force is None or torque is None:
            is_saturated = False
            fault = f"units {record.force_unit.value} and {record.torque_unit.value}; set N and N-m on it"
        six = np.concatenate([np.array(record.force) * (force or np.nan), np.array(record.torque) * (torque or np.nan)])
        return ForceTorqueSample(six, record.received_at_ns, record.rdt_sequence, is_saturated, fault)

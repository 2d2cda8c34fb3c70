"""Calibrated sensors side by side: what differs between two that should be alike, and by how much of its error.

`compare_sensors` reads from each sensor folder the figures on which exchanging sensors depends, each with its standard deviation
where the calibration states one. `certificate.comparison_page` shows them as a page, `ninedtact compare` as a table.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import hypot, isfinite
from pathlib import Path

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.calibration.gel_fit_to_known_loads import MODULUS_STD
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.errors import InputError, printable_text
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose

BALL_RADIUS_MM, BALL_DEPTH_MM = 4.0, 1.0
"""The press whose load is compared: every sensor's twin is pressed alike, whatever ball it was calibrated with."""
_DIFFERENT = 2.0
"""Standard deviations of a difference from which two values count as different."""
_OVEREXPOSED_GREY = 250


@dataclass(frozen=True)
class Measured:
    """A figure of one sensor; `std` is None where the calibration states no error."""

    value: float
    std: float | None = None

    def to_text(self, digits: int) -> str:
        """Return the value with this many decimal places and its error, where there is one."""
        error = "" if self.std is None else f" ± {self.std:.{digits}f}"
        return f"{self.value:.{digits}f}{error}"


@dataclass(frozen=True)
class ComparedQuantity:
    """One row of a comparison: a quantity with its unit, and its figure for every sensor; None where a sensor has none."""

    group: str
    name: str
    unit: str
    digits: int
    measured: tuple[Measured | None, ...]

    @property
    def label(self) -> str:
        """The name with its unit."""
        return f"{self.name} ({self.unit})" if self.unit else self.name

    @property
    def texts(self) -> tuple[str, ...]:
        """The figure of every sensor with its error; a dash where a sensor has none."""
        return tuple("–" if one is None else one.to_text(self.digits) for one in self.measured)

    @property
    def differs(self) -> bool | None:
        """Whether two sensors differ by more than twice the error of their difference; None where errors are not stated."""
        known = [(one.value, one.std) for one in self.measured if one is not None and one.std is not None]
        pairs = [(a, b) for number, a in enumerate(known) for b in known[:number]]
        return any(abs(a[0] - b[0]) > _DIFFERENT * hypot(a[1], b[1]) for a, b in pairs) if pairs else None


@dataclass(frozen=True)
class SensorComparison:
    """Sensors side by side."""

    sensors: tuple[SensorFolder, ...]
    quantities: tuple[ComparedQuantity, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """The sensors' names; the paths of their folders where two sensors have one name."""
        names = tuple(sensor.id for sensor in self.sensors)
        return (
            names
            if len(set(names)) == len(names)
            else tuple(printable_text(str(sensor.path)) for sensor in self.sensors)
        )


def compare_sensors(folders: Sequence[Path | str]) -> SensorComparison:
    """Return the sensors of these folders side by side.

    A figure that a sensor was not calibrated for is None. Raises `InputError` unless two or more different folders are given, and
    what `load_sensor` and `SensorFolder.stored_image` raise.

    >>> comparison = compare_sensors(["left", "right"])
    """
    paths = [Path(folder) for folder in folders]
    if len({path.resolve() for path in paths}) < max(len(paths), 2):
        raise InputError(
            expected="two or more different sensor folders",
            got=", ".join(map(str, paths)) or "none",
            remedy="name each sensor folder once",
        )
    sensors = tuple(load_sensor(path) for path in paths)
    quantities = [
        ComparedQuantity(group, name, unit, digits, tuple(_finite(read(sensor)) for sensor in sensors))
        for group, name, unit, digits, read in _QUANTITIES
    ]
    return SensorComparison(sensors, tuple(row for row in quantities if any(row.measured)))


def _finite(measured: Measured | None) -> Measured | None:
    return measured if measured is not None and isfinite(measured.value) else None


def _scale(sensor: SensorFolder) -> Measured:
    certificate = sensor.record.certificate
    board = None if certificate is None else certificate.board
    return Measured(1000 * sensor.record.grid.mm_per_px, None if board is None else 1000 * board.mm_per_px_std)


def _pin_error(sensor: SensorFolder) -> Measured | None:
    certificate = sensor.record.certificate
    return (
        None
        if certificate is None or certificate.board is None
        else Measured(1000 * certificate.board.leave_one_out_rms_mm)
    )


def _of_reference(read: Callable[[Float32[Array, "rows cols"]], float]) -> Callable[[SensorFolder], Measured | None]:
    def measured(sensor: SensorFolder) -> Measured | None:
        grey = sensor.reference_grey
        return None if grey is None else Measured(float(read(grey)))

    return measured


def _darkening_at(thinning_mm: float) -> Callable[[SensorFolder], Measured | None]:
    """Return a reader of the darkening at a thinning in percent of the reference's brightness, where the curve reaches it."""

    def measured(sensor: SensorFolder) -> Measured | None:
        if sensor.record.depth is None or sensor.depth.curve.max_indentation_mm < thinning_mm:
            return None
        curve, whole = sensor.depth.curve, 1.0
        if curve.signal == "difference":
            grey = sensor.reference_grey
            if grey is None:
                return None
            whole = float(grey.mean())
        at = (curve.indentation_mm, curve.darkening)
        darkening = float(np.interp(thinning_mm, *at))
        slope = float(np.interp(thinning_mm + 0.05, *at) - np.interp(thinning_mm - 0.05, *at)) / 0.1
        error_mm = float(np.interp(thinning_mm, curve.indentation_mm, curve.error_mm))
        return Measured(100 * darkening / whole, 100 * slope * error_mm / whole)

    return measured


def _of_depth(read: Callable[[SensorFolder], float]) -> Callable[[SensorFolder], Measured | None]:
    return lambda sensor: None if sensor.record.depth is None else Measured(read(sensor))


def _fitted(name: str, read: Callable[[SensorFolder], float]) -> Callable[[SensorFolder], Measured | None]:
    """Return a reader of a parameter of the twin with the error of its fit; None without a twin."""

    def measured(sensor: SensorFolder) -> Measured | None:
        twin = sensor.record.twin
        if twin is None:
            return None
        parameter = twin.fit.parameters.get(name)
        return Measured(read(sensor), None if parameter is None else parameter.std)

    return measured


def _modulus_ratio(sensor: SensorFolder) -> Measured | None:
    by_ball = _fitted("gel_to_base_modulus_ratio", lambda sensor: sensor.gel.gel_to_base_modulus_ratio)(sensor)
    known = sensor.record.known_loads
    return by_ball if by_ball is None or known is None else Measured(by_ball.value, known.modulus_ratio_std)


def _modulus(sensor: SensorFolder) -> Measured | None:
    if sensor.record.twin is None:
        return None
    known = sensor.record.known_loads
    return Measured(
        sensor.gel.shear_modulus_mpa, sensor.gel.shear_modulus_mpa * (known.modulus_std if known else MODULUS_STD)
    )


def _force_error(sensor: SensorFolder) -> Measured | None:
    scale = sensor.gel_force_scale
    return None if scale is None else Measured(100 * scale.error)


def _load(sensor: SensorFolder) -> Measured | None:
    """Return the load of one and the same ball on the sensor's twin; None where there is none or the gel is too thin for it."""
    scale = sensor.gel_force_scale
    if scale is None or "ball_reference" not in sensor.record.images:
        return None
    from ninedtact.simulation.twin import ContactLeavesGel

    try:
        press = sensor.twin().press(None, Ball(BALL_RADIUS_MM), Pose(depth_mm=BALL_DEPTH_MM))
    except ContactLeavesGel:
        return None
    return Measured(float(press.load_n), scale.error * float(press.load_n))


_Row = tuple[str, str, str, int, Callable[[SensorFolder], Measured | None]]
_QUANTITIES: tuple[_Row, ...] = (
    ("camera", "scale", "µm per pixel", 2, _scale),
    ("camera", "left-out error of the pins (RMS)", "µm", 1, _pin_error),
    ("light", "brightness of the reference image", "grey levels", 1, _of_reference(np.mean)),
    (
        "light",
        "unevenness of the reference image",
        "% of its brightness",
        1,
        _of_reference(lambda grey: 100 * grey.std() / grey.mean()),
    ),
    (
        "light",
        "overexposed skin",
        "% of the image",
        1,
        _of_reference(lambda grey: 100 * (grey >= _OVEREXPOSED_GREY).mean()),
    ),
    ("depth", "darkening where the gel is 0.5 mm thinner", "% of the brightness", 2, _darkening_at(0.5)),
    ("depth", "darkening where the gel is 1 mm thinner", "% of the brightness", 2, _darkening_at(1.0)),
    ("depth", "calibrated range", "mm", 2, _of_depth(lambda sensor: sensor.depth.curve.max_indentation_mm)),
    ("depth", "noise of a pixel's height", "µm", 2, _of_depth(lambda sensor: 1000 * sensor.depth.noise_mm)),
    (
        "gel",
        "scattering of light (standard deviation)",
        "mm",
        3,
        _fitted("point_spread_mm", lambda sensor: sensor.require_twin().light.point_spread_mm),
    ),
    (
        "gel",
        "thickness with which the gel acts",
        "mm",
        2,
        _fitted("thickness_mm", lambda sensor: sensor.gel.thickness_mm),
    ),
    ("gel", "shear modulus", "MPa", 3, _modulus),
    ("gel", "modulus over that of the base", "", 3, _modulus_ratio),
    ("force", f"load of a ball of {BALL_RADIUS_MM:g} mm, {BALL_DEPTH_MM:g} mm deep", "N", 2, _load),
    ("force", "error common to all forces", "%", 1, _force_error),
)
"""Group, name, unit and decimal places of every compared quantity, and how it is read from a sensor folder."""

"""Which designs are compared: every combination of a few gels, areas and lenses.

Every design of a sweep with what it would do, or the rule that it breaks.
"""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from math import prod
from typing import Any

from ninedtact.design import SensingArea, SensorDesign, shore_a_to_shear_modulus_mpa
from ninedtact.errors import NinedtactError
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.explore.performance_prediction import (
    PerformancePrediction,
    SimulatedCalibrationErrors,
    predict_performance,
    simulate_calibration_errors,
)
from ninedtact.hardware.lens_coverage import required_camera_distance_mm

AreaSize = tuple[float, float]
MAX_DESIGNS = 200
"""More are not looked through by anyone."""
SPARE_MM = 0.1
"""Of distance, beyond what the lens needs to see the corner."""


class _SweepTooLarge(NinedtactError):
    """More designs than anyone looks through."""


@dataclass(frozen=True)
class DesignSweep:
    """Values of each choice; none leaves it as the basis has it."""

    gel_mm: tuple[float, ...] = ()
    """Thickness of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Its hardness."""
    area_mm: tuple[AreaSize, ...] = ()
    """Sensing area, width and height."""
    lens_deg: tuple[float, ...] = ()
    """What the lens sees in air."""

    def designs(self, basis: HardwareDesign) -> "Iterator[DesignChoice]":
        """Every combination; raises `_SweepTooLarge` when the first is asked for."""
        many = prod(max(len(values), 1) for values in vars(self).values())
        if many > MAX_DESIGNS:
            raise _SweepTooLarge(f"expected at most {MAX_DESIGNS} designs, got {many}; give fewer values")
        gels, shores, lenses = self.gel_mm or (None,), self.shore_a or (None,), self.lens_deg or (None,)
        for gel, shore, area, lens in product(gels, shores, self.area_mm or (None,), lenses):
            yield DesignChoice(basis, gel, shore, area, lens)


@dataclass(frozen=True)
class DesignChoice:
    """One combination upon a basis; `None` leaves it."""

    basis: HardwareDesign
    gel_mm: float | None = None
    shore_a: float | None = None
    area_mm: AreaSize | None = None
    lens_deg: float | None = None

    @property
    def hardware(self) -> HardwareDesign:
        """The design; its camera as far away as it must be to see the corner, its pins within the area.

        Raises `DesignImpossible`.
        """
        design = replace(self.basis, sensor=self.sensor)
        needed = required_camera_distance_mm(design)
        if needed <= design.sensor.camera.distance_mm:
            return design
        camera = replace(design.sensor.camera, distance_mm=round(needed + SPARE_MM, 2))
        return replace(design, sensor=replace(design.sensor, camera=camera))

    @property
    def sensor(self) -> SensorDesign:
        """Gel, area and lens as chosen."""
        sensor = self.basis.sensor
        gel, area, camera = sensor.gel, sensor.sensing_area, sensor.camera
        if self.gel_mm is not None:
            gel = replace(gel, thickness_mm=self.gel_mm)
        if self.shore_a is not None:
            gel = replace(gel, shear_modulus_mpa=shore_a_to_shear_modulus_mpa(self.shore_a))
        if self.area_mm is not None:
            area = replace(area, width_mm=self.area_mm[0], height_mm=self.area_mm[1])
        if self.lens_deg is not None:
            camera = replace(camera, lens_angle_deg=self.lens_deg)
        return replace(_fit_pin_board(sensor, area), gel=gel, sensing_area=area, camera=camera)


def _fit_pin_board(sensor: SensorDesign, area: SensingArea) -> SensorDesign:
    """The pin board with as many columns and rows of the same pitch as the area shows, at least three."""
    board = sensor.pin_board
    if area == sensor.sensing_area:
        return sensor
    gaps = [int((side - board.pin_diameter_mm) / board.pitch_mm) for side in area.size_mm]
    cols, rows = (max(many + 1, 3) for many in gaps)
    return replace(sensor, pin_board=replace(board, cols=cols, rows=rows))


@dataclass(frozen=True)
class ExploredDesign:
    """One design of a sweep."""

    design: HardwareDesign
    """Its camera as far from the skin as the lens needs to see the corner, if the basis had it nearer."""
    shore_a: float | None = None
    """Hardness of the gel, if it was asked for by that."""
    prediction: PerformancePrediction | None = None
    refusal: str | None = None
    """Why it cannot be built, or its twin not be pressed."""
    calibration_errors: SimulatedCalibrationErrors | None = None
    """What its twin reads after calibrating itself, if that was asked for."""
    calibration_failure: str | None = None
    """Why that failed."""

    @property
    def name(self) -> str:
        """What sets it apart."""
        sensor = self.design.sensor
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{sensor.gel.shear_modulus_mpa:.3f} MPa"
        area = f"{sensor.sensing_area.width_mm:g}x{sensor.sensing_area.height_mm:g}"
        return f"{sensor.gel.thickness_mm:g} mm, {hard}, {area}, {sensor.camera.lens_angle_deg:g}°"

    def to_json_dict(self) -> dict[str, Any]:
        """For scripts."""
        sensor = self.design.sensor
        return {
            "gel_mm": sensor.gel.thickness_mm,
            "shear_modulus_mpa": sensor.gel.shear_modulus_mpa,
            "area_mm": sensor.sensing_area.size_mm,
            "lens_deg": sensor.camera.lens_angle_deg,
            "distance_mm": sensor.camera.distance_mm,
            "shore_a": self.shore_a,
            "pins": (sensor.pin_board.cols, sensor.pin_board.rows),
            "refusal": self.refusal,
            "calibration_failure": self.calibration_failure,
            **(self.prediction.to_json_dict() if self.prediction else {}),
            **(asdict(self.calibration_errors) if self.calibration_errors else {}),
        }


def explore_designs(choices: Iterable[DesignChoice], calibrated: bool = False) -> Iterator[ExploredDesign]:
    """One after the other; raises `DesignImpossible` for values that no sensor has. calibrated: let each prove itself, too."""
    found = map(_predict_design, choices)
    yield from map(_simulate_calibration, found) if calibrated else found


def _predict_design(choice: DesignChoice) -> ExploredDesign:
    """What it would do, or why it would not."""
    design = choice.hardware
    try:
        return ExploredDesign(design, choice.shore_a, predict_performance(design))
    except NinedtactError as refusal:
        return ExploredDesign(design, choice.shore_a, refusal=str(refusal))


def _simulate_calibration(found: ExploredDesign) -> ExploredDesign:
    """The same with what its twin reads after calibrating itself, or why it cannot."""
    if found.prediction is None:
        return found
    try:
        return replace(found, calibration_errors=simulate_calibration_errors(found.design.sensor))
    except NinedtactError as refusal:
        return replace(found, calibration_failure=str(refusal))

"""A sweep over designs: every combination of a few gels, areas and lenses, each with its predicted performance or the
rule that it breaks."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from itertools import product
from math import prod
from typing import Any

from ninedtact.design import SensingArea, SensorDesign, shore_a_to_shear_modulus_mpa
from ninedtact.errors import InputError, NinedtactError
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
"""Greatest number of designs in one sweep; nobody looks through more."""
SPARE_MM = 0.1
"""Camera distance added to what the lens needs to see the corner."""


class SweepTooLarge(InputError):
    """A sweep over more designs than anyone looks through."""


@dataclass(frozen=True)
class DesignSweep:
    """The values of each choice; an empty tuple keeps that of the base design."""

    gel_mm: tuple[float, ...] = ()
    """Thicknesses of the translucent gel."""
    shore_a: tuple[float, ...] = ()
    """Hardnesses of the translucent gel, Shore A."""
    area_mm: tuple[AreaSize, ...] = ()
    """Sensing areas, width and height."""
    lens_deg: tuple[float, ...] = ()
    """Angles that the lens sees in air."""

    def designs(self, basis: HardwareDesign) -> "Iterator[DesignChoice]":
        """Yield every combination; raises `SweepTooLarge` on the first iteration."""
        many = prod(max(len(values), 1) for values in vars(self).values())
        if many > MAX_DESIGNS:
            raise SweepTooLarge(f"expected at most {MAX_DESIGNS} designs, got {many}; give fewer values")
        gels, shores, lenses = self.gel_mm or (None,), self.shore_a or (None,), self.lens_deg or (None,)
        for gel, shore, area, lens in product(gels, shores, self.area_mm or (None,), lenses):
            yield DesignChoice(basis, gel, shore, area, lens)


@dataclass(frozen=True)
class DesignChoice:
    """One combination applied to a base design; `None` keeps the base design's value."""

    basis: HardwareDesign
    gel_mm: float | None = None
    shore_a: float | None = None
    area_mm: AreaSize | None = None
    lens_deg: float | None = None

    @property
    def hardware(self) -> HardwareDesign:
        """The hardware design with its camera as far away as it must be to see the corner, and its pins within the
        area.

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
        """The sensor design with gel, area and lens as chosen."""
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
    """Return a sensor with as many columns and rows of pins of the same pitch as fit the area, at least three."""
    board = sensor.pin_board
    if area == sensor.sensing_area:
        return sensor
    gaps = [int((side - board.pin_diameter_mm) / board.pitch_mm) for side in area.size_mm]
    cols, rows = (max(many + 1, 3) for many in gaps)
    return replace(sensor, pin_board=replace(board, cols=cols, rows=rows))


@dataclass(frozen=True)
class ExploredDesign:
    """One design of a sweep with its prediction or the reason why there is none."""

    design: HardwareDesign
    """The design, its camera moved away if the lens would not see the corner."""
    shore_a: float | None = None
    """Hardness of the gel, if it was given as Shore A."""
    prediction: PerformancePrediction | None = None
    refusal: str | None = None
    """Why it cannot be built, or its twin cannot be pressed."""
    calibration_errors: SimulatedCalibrationErrors | None = None
    """Errors of its twin after a simulated calibration, if that was requested."""
    calibration_failure: str | None = None
    """Why the simulated calibration failed."""

    @property
    def name(self) -> str:
        """Gel thickness, hardness, area and lens angle, which distinguish it from the others."""
        sensor = self.design.sensor
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{sensor.gel.shear_modulus_mpa:.3f} MPa"
        area = f"{sensor.sensing_area.width_mm:g}x{sensor.sensing_area.height_mm:g}"
        return f"{sensor.gel.thickness_mm:g} mm, {hard}, {area}, {sensor.camera.lens_angle_deg:g}°"

    def to_json_dict(self) -> dict[str, Any]:
        """Return choices, prediction and errors as a dictionary that JSON can hold."""
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
    """Yield the results design by design; raises `DesignImpossible` for values that no sensor has.

    calibrated: whether the twin of each is calibrated and read as well.
    """
    found = map(_predict_design, choices)
    yield from map(_simulate_calibration, found) if calibrated else found


def _predict_design(choice: DesignChoice) -> ExploredDesign:
    """Return the predicted performance of a design, or why there is none."""
    design = choice.hardware
    try:
        return ExploredDesign(design, choice.shore_a, predict_performance(design))
    except NinedtactError as refusal:
        return ExploredDesign(design, choice.shore_a, refusal=str(refusal))


def _simulate_calibration(found: ExploredDesign) -> ExploredDesign:
    """Add the errors after a simulated calibration, or why it failed."""
    if found.prediction is None:
        return found
    try:
        return replace(found, calibration_errors=simulate_calibration_errors(found.design.sensor))
    except NinedtactError as refusal:
        return replace(found, calibration_failure=str(refusal))

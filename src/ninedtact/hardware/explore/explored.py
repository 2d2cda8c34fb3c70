"""Every design of a sweep with what it would do, or the rule that it breaks."""

from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from ninedtact.errors import NinedtactError
from ninedtact.hardware.design import HardwareDesign
from ninedtact.hardware.explore.prediction import Prediction, predict
from ninedtact.hardware.explore.proof import Proof, proof
from ninedtact.hardware.explore.sweep import Choice


@dataclass(frozen=True)
class Explored:
    """One design of a sweep."""

    design: HardwareDesign
    """Its camera as far from the skin as the lens needs to see the corner, if the basis had it nearer."""
    shore_a: float | None = None
    """Hardness of the gel, if it was asked for by that."""
    predicted: Prediction | None = None
    refusal: str | None = None
    """Why it cannot be built, or its twin not be pressed."""
    proved: Proof | None = None
    """What its twin reads after calibrating itself, if that was asked for."""
    uncalibrated: str | None = None
    """Why that failed."""

    @property
    def name(self) -> str:
        """What sets it apart."""
        sensor = self.design.sensor
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{sensor.gel.shear_modulus_mpa:.3f} MPa"
        area = f"{sensor.sensing_area.width_mm:g}x{sensor.sensing_area.height_mm:g}"
        return f"{sensor.gel.thickness_mm:g} mm, {hard}, {area}, {sensor.camera.lens_angle_deg:g}°"

    def as_table(self) -> dict[str, Any]:
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
            "uncalibrated": self.uncalibrated,
            **(self.predicted.as_table() if self.predicted else {}),
            **(asdict(self.proved) if self.proved else {}),
        }


def explored(choices: Iterable[Choice], calibrated: bool = False) -> Iterator[Explored]:
    """One after the other; raises `DesignImpossible` for values that no sensor has. calibrated: let each prove itself, too."""
    found = map(looked_at, choices)
    yield from map(put_to_proof, found) if calibrated else found


def looked_at(choice: Choice) -> Explored:
    """What it would do, or why it would not."""
    design = choice.hardware
    try:
        return Explored(design, choice.shore_a, predict(design))
    except NinedtactError as refusal:
        return Explored(design, choice.shore_a, refusal=str(refusal))


def put_to_proof(found: Explored) -> Explored:
    """The same with what its twin reads after calibrating itself, or why it cannot."""
    if found.predicted is None:
        return found
    try:
        return replace(found, proved=proof(found.design.sensor))
    except NinedtactError as refusal:
        return replace(found, uncalibrated=str(refusal))

"""Every design of a sweep with what it would do, or the rule that it breaks."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from ninedtact.design import DesignImpossible
from ninedtact.errors import NinedtactError
from ninedtact.hardware.explore.prediction import Prediction, predict
from ninedtact.hardware.explore.sweep import Choice


@dataclass(frozen=True)
class Explored:
    """One design of a sweep."""

    gel_mm: float
    shear_modulus_mpa: float
    area_mm: tuple[float, float]
    lens_deg: float
    distance_mm: float
    """From lens to skin; what the lens needs to see the corner, if the basis had it nearer."""
    shore_a: float | None = None
    """As it was asked for."""
    predicted: Prediction | None = None
    refusal: str | None = None
    """Why it cannot be built, or its twin not be pressed."""

    @property
    def name(self) -> str:
        """What sets it apart."""
        hard = f"A{self.shore_a:g}" if self.shore_a is not None else f"{self.shear_modulus_mpa:.3f} MPa"
        area = f"{self.area_mm[0]:g}x{self.area_mm[1]:g}"
        return f"{self.gel_mm:g} mm, {hard}, {area}, {self.lens_deg:g}°"

    def as_table(self) -> dict[str, Any]:
        """For scripts."""
        plain = {name: value for name, value in vars(self).items() if name != "predicted"}
        return {**plain, **(self.predicted.as_table() if self.predicted else {})}


def explored(choices: Iterable[Choice]) -> Iterator[Explored]:
    """One after the other."""
    for choice in choices:
        yield looked_at(choice, predict)


def looked_at(choice: Choice, predicting: Callable[..., Prediction]) -> Explored:
    """What it would do, or why it would not."""
    design = choice.hardware
    sensor = design.sensor
    about = {
        "gel_mm": sensor.gel.thickness_mm,
        "shear_modulus_mpa": sensor.gel.shear_modulus_mpa,
        "area_mm": (sensor.sensing_area.width_mm, sensor.sensing_area.height_mm),
        "lens_deg": sensor.camera.lens_angle_deg,
        "distance_mm": sensor.camera.distance_mm,
        "shore_a": choice.shore_a,
    }
    try:
        return Explored(**about, predicted=predicting(design))  # type: ignore[arg-type]
    except (DesignImpossible, NinedtactError) as refusal:
        return Explored(**about, refusal=str(refusal))  # type: ignore[arg-type]

"""How light, gel, lens and mounting spread over sensors.

Light: ball presses on eight real sensors of five labs (docs/datasets.md; a ninth image was too poor), as logarithms, with
their correlations. There are few of them, so draws end at `REACH` standard deviations. Lens: three real sensors, fitted by
`WideAngleLens` to 0.05 mm. Untouched images: the mean grey of nine sensors. The rest is what moulds, silicone and hands allow.

What lies below the skin.

Two of the three kinds are not what shape and force are estimated with, so that no figure rests on the same model being on
both sides.

What a member is made of besides gel, light and lens.

Member k of a seed: the same whichever others are asked for.
"""

from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any, Literal

import msgspec
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.design import Gel, SensorDesign
from ninedtact.errors import NinedtactError
from ninedtact.mechanics.contact import Contact
from ninedtact.mechanics.finite_strain import finite_strain_height_mm, finite_strain_traction_mpa
from ninedtact.mechanics.layer_compliance import ComplianceFunction, bonded_layer_compliance, layered_compliance
from ninedtact.simulation.illumination import BrightnessModel, saturating_response_mm, synthetic_reference_image
from ninedtact.simulation.pixel_map import PixelMap, WideAngleLens
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import (
    PITCH_MM,
    PUBLISHED_DESIGN,
    Twin,
    illumination_pixel_map,
    lens_for_design,
    scale_brightness_to_design,
)

FITTED_LIGHT_PARAMETERS = np.array(
    [
        (0.164, 0.33, 0.49, 0.012),
        (0.223, 0.53, 0.65, 0.008),
        (0.176, 0.42, 0.52, 0.014),
        (0.129, 0.25, 0.47, 0.009),
        (0.182, 0.44, 0.52, 0.018),
        (0.175, 0.32, 0.60, 0.010),
        (0.177, 0.35, 0.46, 0.008),
        (0.142, 0.41, 0.72, 0.006),
    ]
)
"""a_dark and a_bright per mm, scattering in mm, and the light lost everywhere; one row per real sensor."""
FITTED_AT_MM = 2.0
"""Depth of those presses: a_dark is the slope of the straight line to there."""
MEAN_DARKENING = 0.014
"""Of the whole view, in those presses: turns the lost light into `Light.global_dimming`."""
REACH = 2.0

Random = np.random.Generator


def _sample_light_parameters(rng: Random) -> Float[Array, "4"]:
    """One more row of `FITTED_LIGHT_PARAMETERS`."""
    logs = np.log(FITTED_LIGHT_PARAMETERS)
    root = np.linalg.cholesky(np.cov(logs.T))
    return np.asarray(np.exp(logs.mean(axis=0) + root @ _sample_clipped_normal(rng, 4)))


def _sample_clipped_normal(rng: Random, count: int) -> Float[Array, " count"]:
    """Standard normal numbers without the far tails."""
    return np.clip(rng.standard_normal(count), -REACH, REACH)


def _sample_brightness_model(
    rng: Random, thickness_mm: float, design: SensorDesign = PUBLISHED_DESIGN
) -> BrightnessModel:
    """The light of one sensor with this gel, as of a published one with as much too thick a gel, carried to the design."""
    usual_mm = thickness_mm * (PUBLISHED_DESIGN.gel.thickness_mm / design.gel.thickness_mm)
    return scale_brightness_to_design(_sample_published_brightness_model(rng, usual_mm), design)


def _sample_published_brightness_model(rng: Random, thickness_mm: float) -> BrightnessModel:
    """The light of one published sensor."""
    secant, bright, scattering, lost = _sample_light_parameters(rng).tolist()
    saturation = float(np.exp(rng.uniform(np.log(0.2), np.log(3.5))))
    depth = np.array([-min(FITTED_AT_MM, 0.9 * thickness_mm)])
    bend = float(saturating_response_mm(depth, saturation, thickness_mm)[0] / depth[0])
    nearness = float(np.clip(0.03 + 0.015 * _sample_clipped_normal(rng, 1)[0], 0, None))
    return BrightnessModel(secant / bend, saturation, bright, scattering, lost / MEAN_DARKENING, nearness, thickness_mm)


def _sample_gel(rng: Random, meant: Gel = PUBLISHED_DESIGN.gel) -> Gel:
    """Moulded to 2.5 ± 0.2 mm, or as exactly for its thickness; within a quarter of its modulus; keeping its volume or nearly."""
    thickness = (
        meant.thickness_mm
        + 0.2 * (meant.thickness_mm / PUBLISHED_DESIGN.gel.thickness_mm) * _sample_clipped_normal(rng, 1)[0]
    )
    modulus = meant.shear_modulus_mpa * rng.uniform(0.75, 1.25)
    return Gel(float(thickness), float(modulus), meant.poisson_ratio - min(0.02, float(rng.exponential(0.004))))


def _sample_lens(rng: Random, design: SensorDesign = PUBLISHED_DESIGN) -> WideAngleLens:
    """A lens of the same make, and a skin mounted a little off its axis, turned and tilted."""
    bent, mean = 1 + 0.06 * _sample_clipped_normal(rng, 1)[0], lens_for_design(design)
    pairs = iter((_sample_clipped_normal(rng, 6).reshape(3, 2) * np.array([[0.015], [0.008], [0.2]])).tolist())
    centre, tilt, offset = ((float(x), float(y)) for x, y in pairs)
    return replace(
        mean,
        mm_per_unit=mean.mm_per_unit * (1 + 0.01 * float(_sample_clipped_normal(rng, 1)[0])),
        radial=(mean.radial[0] * bent, mean.radial[1] * bent),
        centre=centre,
        tilt=tilt,
        turn_rad=0.012 * float(_sample_clipped_normal(rng, 1)[0]),
        offset_mm=offset,
    )


MechanicsKind = Literal["bonded", "compliant_base", "finite_strain"]
BASE_STIFFNESS = 10.0
"""Modulus of the transparent layer over that of the gel; Shore A 45 over Shore A 5 is about that."""


def sample_substrate(rng: np.random.Generator, gel: Gel) -> Gel:
    """The transparent layer of one sensor, on a rigid window."""
    modulus = gel.shear_modulus_mpa * BASE_STIFFNESS * rng.uniform(0.8, 1.25)
    return Gel(float(rng.uniform(4.0, 8.0)), float(modulus), gel.poisson_ratio)


def gel_compliance(gel: Gel, base: Gel | None) -> ComplianceFunction:
    """Of gel on a base, or on a rigid one where none is given."""
    return partial(bonded_layer_compliance, gel=gel) if base is None else layered_compliance((gel, base))


def correct_for_mechanics_kind(contact: Contact, kind: MechanicsKind, gel: Gel) -> Contact:
    """From the contact that the linear model solved to the one that is seen and weighed."""
    return apply_finite_strain(contact, gel.thickness_mm) if kind == "finite_strain" else contact


def apply_finite_strain(contact: Contact, thickness_mm: float) -> Contact:
    """Tractions of gel that stiffens where it is thin, heights that pile up (`mechanics.finite_strain`)."""
    height = contact.height_mm
    on_both_axes = height[..., None, :, :] + 0 * contact.shear_mpa
    return replace(
        contact,
        pressure_mpa=finite_strain_traction_mpa(contact.pressure_mpa, height, thickness_mm),
        shear_mpa=finite_strain_traction_mpa(contact.shear_mpa, on_both_axes, thickness_mm),
        height_mm=finite_strain_height_mm(height, thickness_mm),
    )


class InvalidPopulation(NinedtactError):
    """Members that cannot be drawn."""


@dataclass(frozen=True)
class MechanicsShares:
    """The part of all members whose mechanics are not the gel on a rigid base that estimators assume."""

    compliant_base: float = 0.2
    finite_strain: float = 0.3

    def __post_init__(self) -> None:
        if not (min(self.compliant_base, self.finite_strain) >= 0 and self.compliant_base + self.finite_strain <= 1):
            raise InvalidPopulation(
                f"expected shares of members from 0 to 1, together at most 1, got {self.compliant_base} on a compliant base "
                f"and {self.finite_strain} with finite strain; correct them"
            )

    def at(self, part: float) -> MechanicsKind:
        """The kind at this part of the unit."""
        if part < self.compliant_base:
            return "compliant_base"
        return "finite_strain" if part < self.compliant_base + self.finite_strain else "bonded"


@dataclass(frozen=True)
class ReferenceImageSettings:
    """What the untouched image is made from; see `untouched_image`."""

    mean_grey: float
    unevenness: float
    cast: tuple[float, float, float]
    seed: int


@dataclass(frozen=True)
class CalibrationMisalignment:
    """The error of this sensor's board calibration: how the rectified grid lies on the skin."""

    scale: float = 1.0
    """True mm per mm of the grid."""
    turn_rad: float = 0.0
    offset_mm: tuple[float, float] = (0.0, 0.0)


def _sample_reference_image_settings(rng: np.random.Generator) -> ReferenceImageSettings:
    """Mean grey of nine real sensors; white LEDs with a slight cast."""
    red, blue = (0.02 * _sample_clipped_normal(rng, 2)).tolist()
    grey, unevenness = rng.uniform(135, 162), rng.uniform(0.01, 0.03)
    return ReferenceImageSettings(float(grey), float(unevenness), (1 + blue, 1.0, 1 + red), int(rng.integers(2**31)))


def _sample_misalignment(rng: np.random.Generator) -> CalibrationMisalignment:
    """Of a board that was found to a few hundredths of a millimetre."""
    scale, turn, x, y = (_sample_clipped_normal(rng, 4) * (0.005, 0.005, 0.1, 0.1)).tolist()
    return CalibrationMisalignment(1 + scale, turn, (x, y))


RAW_SHAPE = (480, 640)
GOLDEN = 0.618034
"""Its multiples, modulo one, fill the unit evenly from the first on: shares hold among few members too."""


@dataclass(frozen=True)
class SampledSensor:
    """All numbers of one sensor."""

    name: str
    kind: MechanicsKind
    gel: Gel
    base: Gel | None
    """What the gel lies on, where that yields."""
    friction: float
    light: BrightnessModel
    lens: WideAngleLens
    noise_grey_levels: float
    untouched: ReferenceImageSettings
    misreading: CalibrationMisalignment = field(default_factory=CalibrationMisalignment)
    design: SensorDesign = SensorDesign()
    """What it was meant to be."""

    @property
    def view(self) -> PixelMap:
        """Of the raw image."""
        return self.lens.view(RAW_SHAPE)

    def renderer(self) -> Renderer:
        """To raw images."""
        view = self.view
        return Renderer(
            view,
            synthetic_reference_image(illumination_pixel_map(view, self.design), **asdict(self.untouched)),
            self.light,
            CameraNoise(self.noise_grey_levels, RAW_SHAPE),
        )

    def twin(self, pitch_mm: float = PITCH_MM) -> Twin:
        """Ready to be pressed and looked at."""
        yields = self.gel.thickness_mm + (self.base.thickness_mm if self.base else 0.0)
        return Twin(
            self.name,
            gel_compliance(self.gel, self.base),
            self.renderer(),
            self.friction,
            pitch_mm,
            area_mm=self.design.sensing_area.size_mm,
            thickness_mm=yields,
            gel_mm=self.design.sensing_area.gel_mm,
            felt=self.felt,
        )

    def felt(self, contact: Contact) -> Contact:
        """As it is seen and weighed: what the twin solved, corrected where this member's mechanics are not linear."""
        return correct_for_mechanics_kind(contact, self.kind, self.gel)

    def as_table(self) -> dict[str, Any]:
        """Plain numbers, for JSON; `sampled_sensor_from_json` reads them back."""
        return asdict(self)


def sampled_sensor_from_json(table: dict[str, Any]) -> SampledSensor:
    """The sensor that `as_table` wrote."""
    return msgspec.convert(table, SampledSensor)


def sample_sensor(
    number: int, seed: int = 0, kinds: MechanicsShares = MechanicsShares(), design: SensorDesign = SensorDesign()
) -> SampledSensor:
    """Draw one sensor of this design; raises `InvalidPopulation` for numbers below zero."""
    if number < 0 or seed < 0:
        raise InvalidPopulation(f"expected number and seed of zero or more, got {number} and {seed}; correct them")
    rng = np.random.default_rng([seed, number])
    kind = kinds.at((0.5 + GOLDEN * number) % 1)
    gel = _sample_gel(rng, design.gel)
    base = sample_substrate(rng, gel)
    return SampledSensor(
        name=f"twin_{seed}_{number:03d}",
        kind=kind,
        gel=gel,
        base=base if kind == "compliant_base" else None,
        friction=float(rng.uniform(0.5, 1.2)),
        light=_sample_brightness_model(rng, gel.thickness_mm, design),
        lens=_sample_lens(rng, design),
        noise_grey_levels=float(rng.uniform(0.5, 1.0)),
        untouched=_sample_reference_image_settings(rng),
        misreading=_sample_misalignment(rng),
        design=design,
    )


def sample_sensors(seed: int = 0, kinds: MechanicsShares = MechanicsShares()) -> Iterator[SampledSensor]:
    """All members of a seed, without end."""
    number = 0
    while True:
        yield sample_sensor(number, seed, kinds)
        number += 1

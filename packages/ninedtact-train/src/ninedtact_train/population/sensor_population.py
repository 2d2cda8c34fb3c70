"""A population of simulated sensors, for training and evaluating estimators on sensors that they have not seen.

`sample_sensor(number, seed)` returns sensor `number` of a seed: all its parameters, its twin, and its form as JSON.
`rectified_renderer` renders its rectified grey images on the skin's grid, without a raw image in between.

Brightness and gel: `ninedtact calibrate` fitted them to the images of real sensors of several labs (docs/datasets.md). Their
spreads are wide enough that each of these sensors, and every mixture of them, lies well inside. Presses for the calibration: by
hand, with balls from 0.9 to 2.3 mm deep and dragged, boards tilted, and an exposure that drifts between the images. Images: dark
corners, and faint reflections near the border. Lens: fits to three real sensors, which `WideAngleLens` follows to 0.05 mm. All
other spreads are tolerances of moulding, silicone and mounting.

Mechanics: most gels are neo-Hookean and lie on a base that yields, as the model assumes with which shape and force are estimated;
the stiffness of the base differs from sensor to sensor, and some sensors have a rigid base or a linear gel.
"""

from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any

import cv2
import msgspec
import numpy as np
from jaxtyping import Float32, UInt8
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.design import PUBLISHED_RECTIFIED_COLS, Gel, SensorDesign, rectified_mm_per_px
from ninedtact.mechanics.contact_result import Contact
from ninedtact.quantities import centred_axis_mm
from ninedtact.simulation.calibration_images import GUIDED_PRESSES, HandPressImperfections
from ninedtact.simulation.gel_brightness import (
    FITTED_PARAMETERS,
    PUBLISHED_DESIGN,
    BrightnessModel,
    GlarePatch,
    add_glare,
    sample_clipped_normal,
    synthetic_reference_image,
    transfer_brightness_model,
)
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap, WideAngleLens
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import PITCH_MM, Twin, lens_for_design, scale_pixel_map_to_published
from ninedtact_train.population.mechanics_shares import MechanicsKind, MechanicsShares

_SATURATION = 0.1, 6.0
"""Range of the saturation, whose logarithm is uniform."""
_INVERSE_DISTANCE_PER_MM = 0.0, 0.08
_BALL_DEPTH_MM = 0.9, 2.3
_MAX_BALL_DEPTH_FRACTION = 0.85
"""Part of the gel's thickness to which calibrating balls are pressed at most."""
_MAX_BALL_DRAG_MM = 0.5
_BOARD_TILT_RAD, _EXPOSURE_DRIFT = 0.004, 0.004
"""Standard deviations of the board's tilts, and of the relative exposure between the images of a calibration."""
Random = np.random.Generator


def _sample_brightness_model(rng: Random, design: SensorDesign) -> BrightnessModel:
    """Sample the brightness model of a sensor of the published design, scaled to another design.

    The brightness law assumes the designed thickness, as the fits do.
    """
    fitted = {name: one.sample(rng) for name, one in FITTED_PARAMETERS.items() if name != "relative_thickness"}
    published = BrightnessModel(
        **fitted,
        saturation=float(np.exp(rng.uniform(*np.log(_SATURATION)))),
        inverse_distance_per_mm=float(rng.uniform(*_INVERSE_DISTANCE_PER_MM)),
    )
    return transfer_brightness_model(published, design)


def _sample_presses(rng: Random, gel: Gel, design: SensorDesign) -> HandPressImperfections:
    """Sample how a person presses board and ball for the calibration."""
    deepest = min(_BALL_DEPTH_MM[1], _MAX_BALL_DEPTH_FRACTION * gel.thickness_mm)
    # Depths are multiplied by the thickness of the design's gel when the images are simulated.
    thinner = min(1.0, design.gel.thickness_mm / PUBLISHED_DESIGN.gel.thickness_mm)
    depth_mm = rng.uniform(min(_BALL_DEPTH_MM[0], deepest), min(_BALL_DEPTH_MM[1], deepest / thinner))
    angle, drag_mm = rng.uniform(-np.pi, np.pi), _MAX_BALL_DRAG_MM * np.sqrt(rng.uniform())
    tilt = (_BOARD_TILT_RAD * sample_clipped_normal(rng, 2)).tolist()
    return replace(
        GUIDED_PRESSES,
        board_tilt_rad=(tilt[0], tilt[1]),
        ball_depth_mm=float(depth_mm),
        ball_drag_mm=(float(drag_mm * np.cos(angle)), float(drag_mm * np.sin(angle))),
        exposure_drift=float(_EXPOSURE_DRIFT * sample_clipped_normal(rng, 1)[0]),
    )


_BASE_MODULUS_RATIO = 3.0, 100.0
"""Range of the modulus of the layer below the gel over that of the gel, whose logarithm is uniform; the upper end counts as
rigid."""


def _sample_gel(rng: Random, kind: MechanicsKind, meant: Gel = PUBLISHED_DESIGN.gel) -> Gel:
    """Sample a gel: its thickness as it acts, its modulus ± 25 %; nearly incompressible, as silicone is (docs/datasets.md).

    The base of the designed thickness is 3 to 100 times as stiff as the gel, or rigid.
    """
    thickness = meant.thickness_mm * FITTED_PARAMETERS["relative_thickness"].sample(rng)
    modulus = meant.shear_modulus_mpa * rng.uniform(0.75, 1.25)
    poisson_ratio = meant.poisson_ratio - min(0.002, float(rng.exponential(0.0003)))
    ratio = float(np.exp(rng.uniform(*np.log(_BASE_MODULUS_RATIO))))
    return replace(
        meant,
        thickness_mm=float(thickness),
        shear_modulus_mpa=float(modulus),
        poisson_ratio=poisson_ratio,
        finite_strain=0.0 if kind == "linear" else 1.0,
        gel_to_base_modulus_ratio=1 / ratio if kind == "layered" else 0.0,
    )


def _sample_lens(rng: Random, design: SensorDesign = PUBLISHED_DESIGN) -> WideAngleLens:
    """Sample a lens of the same make over a skin that is mounted slightly off its axis, rotated and tilted."""
    bent, mean = 1 + 0.06 * sample_clipped_normal(rng, 1)[0], lens_for_design(design)
    pairs = iter((sample_clipped_normal(rng, 6).reshape(3, 2) * np.array([[0.015], [0.008], [0.2]])).tolist())
    centre, tilt, offset = ((float(x), float(y)) for x, y in pairs)
    return replace(
        mean,
        mm_per_unit=mean.mm_per_unit * (1 + 0.01 * float(sample_clipped_normal(rng, 1)[0])),
        radial=(mean.radial[0] * bent, mean.radial[1] * bent),
        centre=centre,
        tilt=tilt,
        turn_rad=0.012 * float(sample_clipped_normal(rng, 1)[0]),
        offset_mm=offset,
    )


@dataclass(frozen=True)
class ReferenceImageSettings:
    """Arguments of `synthetic_reference_image`."""

    mean_grey: float
    unevenness: float
    cast: tuple[float, float, float]
    seed: int
    vignetting: float = 0.0


@dataclass(frozen=True)
class CalibrationMisalignment:
    """The error of a board calibration: scale, rotation and offset of the rectified grid on the skin."""

    scale: float = 1.0
    """True mm per mm of the grid."""
    turn_rad: float = 0.0
    offset_mm: tuple[float, float] = (0.0, 0.0)


def _sample_reference_image_settings(rng: np.random.Generator) -> ReferenceImageSettings:
    """Sample the mean grey of nine real sensors, white LEDs with a slight cast, and corners darkened by the lens."""
    red, blue = (0.02 * sample_clipped_normal(rng, 2)).tolist()
    grey, unevenness = rng.uniform(135, 162), rng.uniform(0.01, 0.03)
    vignetting, seed = float(rng.uniform(0, 0.35)), int(rng.integers(2**31))
    return ReferenceImageSettings(float(grey), float(unevenness), (1 + blue, 1.0, 1 + red), seed, vignetting)


def _sample_glare(rng: np.random.Generator) -> tuple[GlarePatch, ...]:
    """Sample up to three reflections near the border, of 1 to 6 % of the mean brightness; two of three real sensors have some."""
    patches = []
    for _ in range(int(rng.integers(0, 4))):
        angle, radius = rng.uniform(-np.pi, np.pi), rng.uniform(0.6, 1.0)
        centre = float(radius * np.cos(angle)), float(radius * np.sin(angle))
        patches.append(GlarePatch(centre, float(rng.uniform(0.04, 0.15)), float(rng.uniform(0.01, 0.06))))
    return tuple(patches)


def _sample_misalignment(rng: np.random.Generator) -> CalibrationMisalignment:
    """Sample the error of a board that was located to a few hundredths of a millimetre."""
    scale, turn, x, y = (sample_clipped_normal(rng, 4) * (0.005, 0.005, 0.1, 0.1)).tolist()
    return CalibrationMisalignment(1 + scale, turn, (x, y))


RAW_SHAPE = (480, 640)
GOLDEN = 0.618034
"""The golden ratio, whose multiples modulo one fill the unit interval evenly, so that the shares also hold among few sensors."""


@dataclass(frozen=True)
class SampledSensor:
    """All parameters of one simulated sensor."""

    name: str
    kind: MechanicsKind
    gel: Gel
    friction: float
    light: BrightnessModel
    lens: WideAngleLens
    noise_grey_levels: float
    reference_image: ReferenceImageSettings
    misalignment: CalibrationMisalignment = field(default_factory=CalibrationMisalignment)
    design: SensorDesign = SensorDesign()
    """The design from which the sensor deviates."""
    presses: HandPressImperfections = GUIDED_PRESSES
    """The presses with which it is calibrated."""
    glare: tuple[GlarePatch, ...] = ()
    """Reflections on the image."""

    @property
    def pixel_map(self) -> PixelToSkinMap:
        """The pixel map of the raw image."""
        return self.lens.pixel_map(RAW_SHAPE)

    @cached_property
    def renderer(self) -> Renderer:
        """The renderer of the sensor's raw images."""
        lit = scale_pixel_map_to_published(self.pixel_map, self.design)
        reference, glare = add_glare(synthetic_reference_image(lit, **asdict(self.reference_image)), self.glare)
        return Renderer(self.pixel_map, reference, self.light, CameraNoise(self.noise_grey_levels, RAW_SHAPE), glare)

    def twin(self, pitch_mm: float = PITCH_MM) -> Twin:
        """Return the twin of the sensor."""
        area = self.design.sensing_area
        return Twin(
            self.name, self.gel, self.renderer, self.friction, pitch_mm, area_mm=area.size_mm, gel_mm=area.gel_mm
        )

    def to_json_dict(self) -> dict[str, Any]:
        """Return all parameters as plain numbers; `sampled_sensor_from_json` reads them."""
        return asdict(self)


def sampled_sensor_from_json(table: dict[str, Any]) -> SampledSensor:
    """Return the sensor whose parameters `SampledSensor.to_json_dict` returned."""
    return msgspec.convert(table, SampledSensor)


@checks_arguments
def sample_sensor(
    number: Annotated[int, Meta(ge=0)],
    seed: Annotated[int, Meta(ge=0)] = 0,
    kinds: MechanicsShares = MechanicsShares(),
    design: SensorDesign = SensorDesign(),
) -> SampledSensor:
    """Sample sensor `number` of a seed, which does not depend on other numbers; raises `InputError` below zero."""
    rng = np.random.default_rng([seed, number])
    kind = kinds.kind_at((0.5 + GOLDEN * number) % 1)
    gel = _sample_gel(rng, kind, design.gel)
    return SampledSensor(
        name=f"twin_{seed}_{number:03d}",
        kind=kind,
        gel=gel,
        friction=float(rng.uniform(0.5, 1.2)),
        light=_sample_brightness_model(rng, design),
        lens=_sample_lens(rng, design),
        noise_grey_levels=float(rng.uniform(0.5, 1.0)),
        reference_image=_sample_reference_image_settings(rng),
        misalignment=_sample_misalignment(rng),
        design=design,
        presses=_sample_presses(rng, gel, design),
        glare=_sample_glare(rng),
    )


_INVERSION_STEPS = 12
"""Iterations of the search for a pixel of the raw image; each reduces the error to a fifth."""

Grey = UInt8[Array, "rows cols"]
Plane = Float32[Array, "rows cols 2"]


@dataclass(frozen=True)
class RectifiedRenderer:
    """Renders the rectified grey images of one sensor."""

    renderer: Renderer
    """The renderer whose view is the rectified grid."""

    @cached_property
    def reference(self) -> Float32[Array, "rows cols"]:
        """The reference image (no contact) without noise."""
        return np.asarray(cv2.cvtColor(self.renderer.reference, cv2.COLOR_BGR2GRAY))

    def render(self, contact: Contact | None, rng: np.random.Generator) -> Grey:
        """Return the image of a contact (None: nothing touches) with noise from `rng`."""
        return self.add_noise(self.brightness_factor(contact), rng)

    def brightness_factor(self, contact: Contact | None) -> Float32[Array, "rows cols"] | None:
        """Return the brightness of every pixel relative to the reference image; None without contact."""
        return self.renderer.brightness_factor(contact) if contact is not None and contact.touches else None

    def add_noise(self, factor: Float32[Array, "rows cols"] | None, rng: np.random.Generator) -> Grey:
        """Return the image with this brightness relative to the reference image and with noise from `rng`."""
        clean = self.reference if factor is None else self.reference * factor
        noise = rng.standard_normal(clean.shape, np.float32) * np.float32(self.renderer.noise.grey_levels)
        return np.asarray(cv2.add(clean, noise, dtype=cv2.CV_8U))


def rectified_renderer(member: SampledSensor, size: tuple[int, int]) -> RectifiedRenderer:
    """Return the renderer of a sensor for images of (cols, rows). Small images are means over pixels and have less noise."""
    raw = member.renderer
    plane = misaligned_pixel_positions_mm(size, rectified_mm_per_px(size, member.design), member.misalignment)
    pixels = raw_pixels_seeing(raw.pixel_map, plane)
    untouched = interpolate_image(raw.reference, pixels)
    glare = None if raw.glare is None else interpolate_image(raw.glare[..., None], pixels)
    calmer = member.noise_grey_levels * min(1.0, size[0] / PUBLISHED_RECTIFIED_COLS)
    rows, cols = plane.shape[:2]
    noise = CameraNoise(calmer, (rows, cols))
    return RectifiedRenderer(Renderer(PixelToSkinMap(plane), untouched, raw.light, noise, glare))


def misaligned_pixel_positions_mm(
    size: tuple[int, int], mm_per_px: float, misalignment: CalibrationMisalignment
) -> Plane:
    """Return where on the skin the pixels of a rectified image of (cols, rows) truly lie, given the error of its calibration."""
    x, y = np.meshgrid(*(centred_axis_mm(side, mm_per_px) for side in size))
    cos, sin = np.cos(misalignment.turn_rad), np.sin(misalignment.turn_rad)
    turned = np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)
    return (misalignment.scale * turned + misalignment.offset_mm).astype(np.float32)


def raw_pixels_seeing(view: PixelToSkinMap, plane_mm: Plane) -> Plane:
    """Return the pixels (x, y) of the raw image that see these positions: the inverse of the view, by fixed-point iteration."""
    rows, cols = view.raw_shape
    across = (view.plane_mm[rows // 2, -1, 0] - view.plane_mm[rows // 2, 0, 0]) / (cols - 1)
    last = np.array([cols - 1, rows - 1], np.float32)
    px = last / 2 + plane_mm / across
    for _ in range(_INVERSION_STEPS):
        px = np.clip(px, 0, last).astype(np.float32)
        px = px - (interpolate_image(view.plane_mm, px) - plane_mm) / across
    return px.astype(np.float32)


def interpolate_image(field: Float32[Array, "raw_rows raw_cols n"], px: Plane) -> Float32[Array, "rows cols *n"]:
    """Return an image at these pixels (x, y) by linear interpolation; one of a single channel has none afterwards."""
    x, y = (np.ascontiguousarray(px[..., axis]) for axis in range(2))
    return np.asarray(cv2.remap(field, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE))

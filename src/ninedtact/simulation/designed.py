"""The twin of a sensor that is designed but not built: what changes from the average sensor when the design does.

The gel's thickness t changes the light as the reflectance St/(1 + St) of its layer does (Kubelka and Munk 1931,
docs/references.md): slope and saturation of the brightness law; scattering spreads light over a part of the thickness that
stays the same. The camera's distance and the way light is bent into acrylic and silicone change the scale of the image.
The exposure is taken to be set so that untouched skin is as bright as ever.
"""

from dataclasses import replace
from functools import partial

import numpy as np

from ninedtact.design import ACRYLIC_REFRACTIVE_INDEX, SILICONE_REFRACTIVE_INDEX, SensorDesign
from ninedtact.mechanics.layer_compliance import bonded_layer_compliance
from ninedtact.simulation.image import Renderer
from ninedtact.simulation.light import Light
from ninedtact.simulation.noise import Noise
from ninedtact.simulation.twin import Twin
from ninedtact.simulation.untouched import untouched_image
from ninedtact.simulation.view import View, WideLens

AVERAGE = SensorDesign()
"""The design of the sensors that the defaults of light and lens come from."""
AIR_MM, ACRYLIC_MM = 0.35, 2.0
"""Between lens front and gel in the published sensor; the rest is silicone."""


def designed_twin(design: SensorDesign, seed: int = 0) -> Twin:
    """The twin that a sensor of this design would have; that of the published design is `default_twin`."""
    view = designed_lens(design).view()
    noise = Noise(shape=view.raw_shape, seed=seed)
    renderer = Renderer(view, untouched_image(lit_alike(view, design), seed=seed), designed_light(design), noise)
    area = design.sensing_area
    return Twin(
        "default" if design == AVERAGE else "designed",
        partial(bonded_layer_compliance, gel=design.gel),
        renderer,
        area_mm=area.size_mm,
        thickness_mm=design.gel.thickness_mm,
        gel_mm=area.gel_mm,
    )


def designed_light(design: SensorDesign) -> Light:
    """The average light, carried to this design."""
    return carried_light(Light(), design)


def carried_light(light: Light, design: SensorDesign) -> Light:
    """The light of a sensor of the published design → that through the gel of another, seen from its distance."""
    thicker = design.gel.thickness_mm / AVERAGE.gel.thickness_mm
    steeper = slope_per_mm(design.gel.thickness_mm, light) / slope_per_mm(AVERAGE.gel.thickness_mm, light)
    return replace(
        light,
        darkening_per_mm=light.darkening_per_mm * steeper,
        brightening_per_mm=light.brightening_per_mm * steeper,
        saturation=light.saturation * thicker,
        point_spread_mm=light.point_spread_mm * thicker,
        nearness_per_mm=light.nearness_per_mm * (AVERAGE.camera.distance_mm / design.camera.distance_mm),
        thickness_mm=light.thickness_mm * thicker,
    )


def slope_per_mm(thickness_mm: float, light: Light) -> float:
    """Relative change of the reflectance St/(1 + St) with t."""
    scattered = light.saturation / light.thickness_mm * thickness_mm
    return 1 / (thickness_mm * (1 + scattered))


def designed_lens(design: SensorDesign) -> WideLens:
    """The average lens, looking from this distance; a narrower lens spreads its image over less skin."""
    lens = WideLens()
    nearer = optical_mm(design) / optical_mm(AVERAGE)
    narrower = design.camera.lens_angle_deg / AVERAGE.camera.lens_angle_deg
    return replace(lens, mm_per_unit=lens.mm_per_unit * nearer * narrower)


def optical_mm(design: SensorDesign) -> float:
    """Radius gained per radian near the axis, on the way through air, acrylic and silicone."""
    silicone = max(design.camera.distance_mm - AIR_MM - ACRYLIC_MM, 0.0)
    return AIR_MM + ACRYLIC_MM / ACRYLIC_REFRACTIVE_INDEX + silicone / SILICONE_REFRACTIVE_INDEX


def lit_alike(view: View, design: SensorDesign) -> View:
    """The view on the average sensor that shows the light of this one: LEDs stand round the area, however large it is."""
    area, average = design.sensing_area, AVERAGE.sensing_area
    if area == average:
        return view
    smaller = np.array([average.width_mm / area.width_mm, average.height_mm / area.height_mm], np.float32)
    return View(view.plane_mm * smaller)

"""The depth of the calibration's ball where the gel is not the model's: both presses, of the ball and of the flat end, are computed
with axisymmetric finite elements (neo_hookean.py, ball_in_layer.py), and their images are drawn from the thickness of that gel.

The fit knows neither base nor thickness nor light, only the radii and the depth of the flat end. Images are drawn without lens,
seen from far away, on the rectified grid. The truth is that of the finite elements.
"""

from dataclasses import replace

import numpy as np
import tyro
from ball_in_layer import Press, follow
from figures import Figure, answer, at_most
from finite_strain import FLAT_END, meridian_of
from neo_hookean import Layer, Parts
from scipy.ndimage import gaussian_filter

from ninedtact import SensorDesign
from ninedtact.calibration.ball.ball_press import BallPress, find_usable_contact_circle
from ninedtact.calibration.ball.second_press import ObjectPress, PressedFlatEnd
from ninedtact.calibration.twin.ball_press_fit import TwinFit, fit_twin_to_ball_press
from ninedtact.design import FlatEndGauge, rectified_grid_of_design
from ninedtact.mechanics.indenter import Ball, FlatPunch
from ninedtact.quantities import Rectified, skin_grid_mm
from ninedtact.simulation.gel_brightness import brightness_model_for_design

BASES = {"5": 5.0, "10": 10.0, "25": 25.0, "rigid": 0.0}
GEL_MM, BASE_MM, DESIGN = 2.5, 9.2, SensorDesign()
BALL_MM, STEP_MM = 1.5, 0.1
GREY, NOISE_GREY = 150.0, 0.3
MAX_RELATIVE_ERROR = 0.03


def second_press_in_elements(quick: bool = False, json: bool = False, element_mm: float = 0.25) -> None:
    """Fit one ball, then ball and flat end, on every base."""
    figures: list[Figure] = []
    for base, ratio in list(BASES.items())[-1:] if quick else BASES.items():
        alone, both = fits(ratio, 0.5 if quick else element_mm)
        for name, fit in (("one ball", alone), ("ball and flat end", both)):
            std = fit.uncertainty.standard_deviations["depth_mm"] / BALL_MM
            error = fit.press.depth_mm / BALL_MM - 1
            figures.append(at_most(f"base {base}, {name}: error of the depth", abs(error), MAX_RELATIVE_ERROR))
            words = f"{error:+.1%} ± {std:.1%}, {abs(error) / std:.1f} σ; base {fit.base.modulus_ratio:.3f} ± {fit.base.std:.3f}"
            figures.append(Figure(f"base {base}, {name}", words))
    answer("Depth of a ball in finite elements, with a flat end at a known depth", figures, json)


def fits(ratio: float, element_mm: float) -> tuple[TwinFit, TwinFit]:
    """The ball fitted alone, and with the flat end. ratio: modulus of the base over that of the gel, zero for a rigid one."""
    layer = Layer(GEL_MM, 24.0, element_mm, base_thickness_mm=BASE_MM if ratio else 0.0, base_modulus=ratio or 1.0)
    rng, gauge = np.random.default_rng(5), FlatEndGauge()
    ball_image = draw(press_elements(layer, Ball(DESIGN.ball.radius_mm), BALL_MM), rng)
    flat_image = draw(press_elements(layer, FLAT_END, gauge.depth_mm), rng)
    before = replace(ball_image, grey=np.full_like(ball_image.grey, GREY))
    circle = find_usable_contact_circle(before, ball_image, DESIGN.ball, "physics")
    press, pressed = BallPress(before, ball_image, circle, DESIGN.ball), PressedFlatEnd(gauge)
    second = ObjectPress(before, flat_image, pressed.find_contact(before, flat_image, "physics"), pressed)
    return fit_twin_to_ball_press(press, DESIGN), fit_twin_to_ball_press(press, DESIGN, further=(second,))


def press_elements(layer: Layer, pressed: Ball | FlatPunch, depth_mm: float) -> Press:
    """The finite elements in balance at a depth."""
    depths_mm = np.round(np.arange(STEP_MM, depth_mm + 1e-9, STEP_MM), 3).tolist()
    *_, last = follow(Parts(layer), *meridian_of(pressed, depths_mm))
    return last


def draw(press: Press, rng: np.random.Generator) -> Rectified:
    """The rectified image of the gel's thickness in the light of the design."""
    shape, mm_per_px = rectified_grid_of_design(DESIGN)
    light = brightness_model_for_design(DESIGN)
    change_mm = press.thickness_change_mm(np.hypot(*skin_grid_mm(shape, mm_per_px)))
    bright = gaussian_filter(1 + light.brightness_change(change_mm), light.point_spread_mm / mm_per_px)
    return Rectified((GREY * bright + rng.normal(0, NOISE_GREY, shape)).astype(np.float32), mm_per_px)


if __name__ == "__main__":
    tyro.cli(second_press_in_elements)

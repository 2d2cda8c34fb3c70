"""What a calibration finds where the ball was pressed into finite elements: a neo-Hookean gel of known thickness.

The finite elements are those of `neo_hookean.py`, seen by the twin of a real sensor; its board and light are the twin's. Each press
is fitted twice: with the gel's share of finite strain as it is found, and held at that of a linear layer.
"""

from dataclasses import replace

import cv2
import numpy as np
import tyro
from ball_in_layer import Press, RigidBall, follow
from figures import Figure, answer, at_most
from neo_hookean import Layer, Parts

from ninedtact.calibration.ball.ball_press import find_ball_press
from ninedtact.calibration.board.board_fit import build_rectification, fit_board
from ninedtact.calibration.twin.ball_press_fit import ParameterPrior, TwinFit, fit_twin_to_ball_press
from ninedtact.design import Gel
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin
from ninedtact_train.population.real_sensor_twins import twins_of_real_fits

SENSOR, GEL, BALL_MM = "L", Gel(thickness_mm=1.973), 4.0
DEPTHS_MM = (0.8, 1.1, 1.4)
LINEAR = (ParameterPrior("finite_strain", 0.0, 1e-4),)


def finite_strain_calibration(quick: bool = False, json: bool = False, element_mm: float = 0.12) -> None:
    """Fit the presses and print what is found of thickness and depth; about a minute."""
    cv2.setNumThreads(1)
    member = replace(twins_of_real_fits()[SENSOR], gel=GEL)
    twin, design = member.twin(), member.design
    images = simulate_calibration_images(twin, design, presses=member.presses)
    rectify = build_rectification(fit_board(images.board_reference, images.board, design.pin_board), design)
    depths_mm, element_mm = (DEPTHS_MM[:1], 0.4) if quick else (DEPTHS_MM, element_mm)
    figures: list[Figure] = []
    steps_mm = np.arange(1, round(depths_mm[-1] / 0.1) + 1) * 0.1
    layer = Layer(thickness_mm=GEL.thickness_mm, element_mm=element_mm)
    for press in follow(Parts(layer), RigidBall(BALL_MM, sticks=True), steps_mm.round(3).tolist()):
        if press.depth_mm not in depths_mm:
            continue
        image = twin.renderer(draw_press(twin, press), 1)
        seen = find_ball_press(rectify, images.ball_reference, image, design.ball, "physics")
        found, linear = (fit_twin_to_ball_press(seen, design, priors) for priors in ((), LINEAR))
        figures += compare(press.depth_mm, found, linear)
    answer("A ball on finite elements: fitted (peer: held at a linear layer)", figures, json)


def draw_press(twin: Twin, press: Press) -> Contact:
    """Return the twin's contact at the depth of a press, with the height of the finite elements."""
    contact = ScriptedPress(press.depth_mm).simulate(twin, Ball(BALL_MM))
    x, y, _ = contact.surface_points_mm
    r, across, up = press.profile_mm
    height = np.interp(np.hypot(x, y), r + across, up, right=0.0)
    return replace(contact, height_mm=height.astype(np.float32))


def compare(depth_mm: float, found: TwinFit, linear: TwinFit) -> list[Figure]:
    """Return what both fits find of one press."""
    true = {"thickness_mm": GEL.thickness_mm, "depth_mm": depth_mm}
    off = [{name: 100 * (fit.parameters[name] / value - 1) for name, value in true.items()} for fit in (found, linear)]
    name = f"{depth_mm:g} mm deep: "
    return [
        Figure(name + "share of finite strain", found.press.finite_strain),
        *(
            at_most(
                f"{name}{each.removesuffix('_mm')}, error of the fit, %",
                abs(off[0][each]),
                limit,
                peer=abs(off[1][each]),
            )
            for each, limit in (("thickness_mm", 5.0), ("depth_mm", 3.0))
        ),
    ]


if __name__ == "__main__":
    tyro.cli(finite_strain_calibration)

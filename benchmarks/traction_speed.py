"""Time of force without training in a live stream: a ball is pressed, dragged and lifted before a camera of 345 x 460 pixels.

Processor time of one thread for one estimate, the height map being there already; and how far the live answers, each a
few steps from the one before, are from those that a patient search gives.
"""

from collections.abc import Iterator
from dataclasses import replace
from time import process_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most

from ninedtact.design import Gel
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.force.traction.observation import BrightnessObservationModel
from ninedtact.force.traction.traction_from_brightness import SolverSettings
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, Rectified
from ninedtact.reading import Reading
from ninedtact.shape.calibrated_shape import retain_freed_memory
from ninedtact.shape.depth import DepthCurve, GlobalDimmingModel
from ninedtact.simulation.ground_truth import true_height_map
from ninedtact.simulation.twin import default_twin

SHAPE, PX_MM, SCATTERING_MM = (345, 460), 0.0522, 0.5
DEPTH = np.linspace(0, 2, 21)
CURVE = DepthCurve("ratio", tuple((0.15 * DEPTH).tolist()), tuple(DEPTH.tolist()), (0.01,) * 21, (0.0, 0.4), (0.0, 1.0))
PATIENT = SolverSettings(max_iterations=20, target_decrement=0.02)


def traction_speed(frames: int = 60, json: bool = False) -> None:
    """Live against patient."""
    cv2.setNumThreads(1)
    retain_freed_memory()
    live, patient = (
        TractionForce(BrightnessObservationModel(CURVE, GlobalDimmingModel(), SCATTERING_MM), Gel(), solver=how)
        for how in (SolverSettings(), PATIENT)
    )
    ms, off, load = [], [], []
    for number, reading in enumerate(stream(frames)):
        start = process_time()
        quick = live.estimate(reading)
        ms.append((process_time() - start) * 1e3)
        if number % 4 == 3:
            patient.forget()
            slow = patient.estimate(reading)
            off.append(np.abs(quick.wrench.force_n - slow.wrench.force_n))
            load.append(abs(slow.wrench.force_n[2]))
    part = float(np.max(np.array(off)) / np.max(load))
    figures = [
        at_most("one estimate, median (ms)", float(np.median(ms[2:])), 5.0, "ms"),
        Figure("one estimate, 95 of 100 (ms)", float(np.percentile(ms[2:], 95))),
        at_most("largest distance from the patient answer, over the largest load", part, 0.01),
    ]
    answer("Force without training, live", figures, json)


def stream(frames: int) -> Iterator[Reading]:
    """A press, a drag, and the way back."""
    twin, rng = default_twin(), np.random.default_rng(0)
    press = None
    before = Rectified(np.full(SHAPE, 150, np.float32), PX_MM)
    for part in np.linspace(0.1, 1, frames):
        pose = Pose(2 * part, -part, float(1.1 * np.sin(np.pi * min(part, 0.75)) + 0.05))
        press = twin.press(press, Ball(4.0), pose)
        true = true_height_map(press.corrected, SHAPE, PX_MM)
        change = np.where(true.z_mm < 0, 0.15 * true.z_mm, 0.4 * true.z_mm)
        sigma = SCATTERING_MM / PX_MM
        seen = cv2.GaussianBlur(change, (0, 0), sigma) + rng.normal(0, 0.005, SHAPE)
        smooth = cv2.GaussianBlur(seen.astype(np.float32), (0, 0), 2.0)
        height = replace(true, z_mm=CURVE.height_mm(smooth).astype(np.float32))
        after = Rectified((150 * (1 + seen)).astype(np.float32), PX_MM)
        yield Reading(Frame(np.zeros((1, 1, 3), np.uint8)), after, height, reference=before)


if __name__ == "__main__":
    tyro.cli(traction_speed)

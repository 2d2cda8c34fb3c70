"""Draws what force without training reads, beside the truth: pressure, and shear as arrows (docs/force_physics.md).

The sensor is a twin of the population, calibrated from its own images; it is dragged over by a cylinder and by a star.
"""

from pathlib import Path

import cv2
import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
import tyro
from traction_skill import bench

from ninedtact.force.traction.traction_from_brightness import SolverSettings
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import LyingCylinder
from ninedtact.quantities import Traction, WrenchEstimate
from ninedtact.simulation.ground_truth import true_pressure_map_mpa, true_shear_map_mpa
from ninedtact.simulation.objects.catalogue import generate_object
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact_train.population.rectified_renderer import rectified_renderer
from ninedtact_train.population.sensor_population import sample_sensor

SIZE = (240, 180)
PRESSES = (
    (LyingCylinder(3.0, 8.0), ScriptedPress(load_n=6.0, at_mm=(1.0, 0.5), drag_mm=(0.7, 0.3))),
    (generate_object("star_01"), ScriptedPress(load_n=7.0, at_mm=(-1.0, -0.5), drag_mm=(-0.1, 0.6), twist_rad=0.1)),
)


def traction_image(
    out: Path = Path("docs/images/force_physics.png"),
    folders: Path = Path("out/force_study/sensors"),
    number: int = 23,
) -> None:
    """One row for each press: truth, then what was read."""
    cv2.setNumThreads(1)
    who, rng = sample_sensor(number, seed=1), np.random.default_rng(0)
    eye = rectified_renderer(who, SIZE)
    set_up = bench(who, eye.render(None, rng), folders, 1.96, SolverSettings())
    assert set_up is not None
    figure, rows = plt.subplots(len(PRESSES), 3, figsize=(11.5, 5.6), squeeze=False, layout="constrained")
    for row, (indenter, press) in zip(rows, PRESSES, strict=True):
        contact = press.simulate(who.twin(), indenter, None)
        reading = set_up.reading(eye.render(contact, rng))
        set_up.estimator.forget()
        estimate = set_up.estimator.estimate(reading)
        draw_row(row, contact, estimate, reading.rectified.grey)
    figure.savefig(out, dpi=110)


def draw_row(row: np.ndarray, contact: Contact, estimate: WrenchEstimate, grey: np.ndarray) -> None:
    """Image, truth, answer."""
    assert estimate.traction is not None
    read = estimate.traction
    shape = read.pressure_mpa.shape
    true = Traction(
        true_pressure_map_mpa(contact, shape, read.mm_per_px).astype(np.float32),
        np.moveaxis(true_shear_map_mpa(contact, shape, read.mm_per_px), -1, 0).astype(np.float32),
        read.mm_per_px,
    )
    row[0].imshow(grey, cmap="gray", extent=(-12, 12, 9, -9))
    row[0].set_title("image", fontsize=9)
    row[0].set(xlabel="x (mm)", ylabel="y (mm)")
    most = float(true.pressure_mpa.max())
    wrench = contact.wrench()
    draw(row[1], true, most, "true: " + told(wrench.force_n, wrench.torque_nm))
    error = " ± " + ", ".join(f"{value:.2f}" for value in estimate.std[:3])
    draw(row[2], read, most, "read: " + told(estimate.wrench.force_n, estimate.wrench.torque_nm) + f"\n(N {error})")


def told(force_n: np.ndarray, torque_nm: np.ndarray) -> str:
    force = ", ".join(f"{value:+.2f}" for value in force_n)
    return f"F = {force} N, Tz = {torque_nm[2] * 1e3:+.1f} mN·m"


def draw(axes: plt.Axes, traction: Traction, most: float, title: str) -> None:
    """Pressure as colour, shear as arrows."""
    rows, cols = traction.pressure_mpa.shape
    half_x, half_y = cols * traction.mm_per_px / 2, rows * traction.mm_per_px / 2
    axes.imshow(traction.pressure_mpa, cmap="magma", vmin=0, vmax=most, extent=(-half_x, half_x, half_y, -half_y))
    x, y = np.meshgrid(np.linspace(-half_x, half_x, cols), np.linspace(-half_y, half_y, rows))
    every = np.s_[::2, ::2]
    q_x, q_y = (part[every] for part in traction.shear_mpa)
    axes.quiver(x[every], y[every], q_x, q_y, color="cyan", angles="xy", scale=most * 8, width=0.004)
    axes.set(xlim=(-12, 12), ylim=(9, -9), xlabel="x (mm)")
    axes.set_title(title, fontsize=8)


if __name__ == "__main__":
    tyro.cli(traction_image)

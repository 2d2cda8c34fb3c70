"""The paper's protocol on twins, 20 presses of another ball at various places, and presses of objects of all families.

Each sensor is calibrated from its own four images, lens and all, by each method; every press has its own place, load, drag and
noise. Errors are of single pixels where the object has pressed the skin in, against the skin that was drawn. The published figures
are of a real sensor, with the depth told by the rule of the disc's edge: not the same test.

The objects are pressed on the twin that the calibration itself gives, so that only the reading errs, and read by `physics`, which
knows nothing of them. Every sensor meets other families and other objects. With `--presses 0` there are no balls but these objects.
Beside the heights that are read stand those that the solved tractions have on the skin of the force estimate, and means of both,
and the true skin without the waves that scattering hides: what no reading that adds nothing of its own can improve on.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_most
from real_images import calibrated
from scipy.fft import dctn, idctn
from scipy.ndimage import map_coordinates

from ninedtact import (
    CalibrationImages,
    Frame,
    Pose,
    calibrate,
    indenter_from_name,
    orthorectify,
)
from ninedtact.calibration.ball.ball_fit import fit_ball
from ninedtact.calibration.save import save_sensor
from ninedtact.errors import SimulationError
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.pose import InvalidPose
from ninedtact.quantities import HeightMap, Traction, skin_grid_mm
from ninedtact.reading import read_frame
from ninedtact.shape.calibrated_shape import DepthReader, mean_rectified_image
from ninedtact.shape.depth import DepthMethod
from ninedtact.shape.surface import max_indentation_mm
from ninedtact.simulation.calibration_images import GUIDED_FRAMES, GUIDED_PRESSES, simulate_calibration_images
from ninedtact.simulation.ground_truth import true_height_map, true_height_map_like
from ninedtact.simulation.objects.catalogue import FAMILIES_BY_KIND
from ninedtact.simulation.trajectory import ScriptedPress
from ninedtact.simulation.twin import Twin
from ninedtact_train.population.mechanics_shares import MechanicsShares
from ninedtact_train.population.sensor_population import SampledSensor, sample_sensor

METHODS: tuple[DepthMethod, ...] = ("ratio", "table")
OTHER_BALL = Ball(5.0)
DEEPER_THAN_MM = 0.05
LIMIT_MM = 0.020
OBJECT_LIMITS_UM = {"mean": 18.0, "worst": 40.0}
NEAR_SHARE, NEAR_UM = 0.05, 15.0
"""A maximum indentation is near where it is within this share of the true one, or within these µm."""
LOADS_N = (4.0, 10.0)
PUBLISHED = {"MAE": 0.0462, "Std": 0.0304}
ASSUMED = "base that yields"
OBJECTS_PER_SENSOR = 16
LEAST_LEFT = 0.14, 0.03
"""Shares of a wave that scattering leaves, from which on it counts as seen: about that of the deblurring, and one at which the
noise of the camera, amplified by its reciprocal, is as large as what the waves beyond add."""
KINDS: dict[str, MechanicsShares] = {
    ASSUMED: MechanicsShares(rigid_base=0.0, linear=0.0),
    "rigid base": MechanicsShares(rigid_base=1.0, linear=0.0),
    "linear gel": MechanicsShares(rigid_base=0.0, linear=1.0),
}


@dataclass(frozen=True)
class ObjectPress:
    """One press of one object, read by `physics`; µm."""

    name: str
    kind: str
    mae: float
    deepest: float
    """True maximum indentation."""
    deepest_off: float
    stated: float
    """Standard deviation that is stated for it."""
    mae_of_tractions: float
    """MAE of the skin under the tractions of the force estimate."""
    mae_of_both: float
    """MAE of the mean of both heights."""
    mae_of_seen: tuple[float, ...]
    """MAE of the true skin without the waves that scattering hides, for each of `LEAST_LEFT`."""

    @property
    def is_near(self) -> bool:
        return abs(self.deepest_off) <= max(NEAR_SHARE * self.deepest, NEAR_UM)


@dataclass(frozen=True)
class Errors:
    """Of one sensor by one reading, mm."""

    mae: float
    std: float
    peak: float
    """Mean absolute error of the deepest point."""


def reconstruction_study(
    sensors: int = 10, presses: int = 20, seed: int = 0, quick: bool = False, json: bool = False
) -> None:
    """Study sensors whose mechanics the estimator assumes, and those of other mechanics."""
    cv2.setNumThreads(1)
    sensors, presses = (1, 0) if quick else (sensors, presses)
    figures: list[Figure] = []
    for kind in KINDS if presses else (ASSUMED,):
        found, objects = [], []
        for number in range(sensors if kind == ASSUMED else max(sensors // 3, 1)):
            sensor = StudiedSensor(sample_sensor(number, seed, KINDS[kind]), quick)
            if presses:
                found.append(sensor.ball_errors(presses, seed + number))
            if kind == ASSUMED:
                objects += list(sensor.object_presses(number, 1 if quick else OBJECTS_PER_SENSOR))
        figures += list(ball_figures(kind, found)) if found else []
        figures += list(object_figures(objects)) if objects else []
    answer(
        f"Reconstruction of a ball of radius {OTHER_BALL.radius_mm:g} mm and of other objects on twins", figures, json
    )


def ball_figures(kind: str, found: list[dict[str, Errors]]) -> Iterator[Figure]:
    """Medians over the sensors of one kind."""
    for reading in found[0]:
        for name, value in (("MAE", "mae"), ("Std", "std"), ("deepest point, MAE", "peak")):
            middle = median(getattr(errors[reading], value) for errors in found)
            figure, peer = f"{kind}, {reading}: {name} (mm)", PUBLISHED.get(name, "")
            required = reading == "physics" and kind == ASSUMED and name in PUBLISHED
            yield at_most(figure, middle, LIMIT_MM, "mm", peer) if required else Figure(figure, middle, peer=peer)


def object_figures(presses: list[ObjectPress]) -> Iterator[Figure]:
    """All presses of objects, those of each kind of object, and the worst."""
    for kind in ("all", *dict.fromkeys(press.kind for press in presses)):
        these = [press for press in presses if kind in ("all", press.kind)]
        worst = max(these, key=lambda press: press.mae)
        mean_mae, name = float(np.mean([press.mae for press in these])), f"objects, {kind} ({len(these)})"
        if kind == "all":
            yield at_most(f"{name}: MAE, mean (µm)", mean_mae, OBJECT_LIMITS_UM["mean"], "µm")
            yield at_most(f"{name}: MAE, worst, {worst.name} (µm)", worst.mae, OBJECT_LIMITS_UM["worst"], "µm")
            for what, values in (
                ("heights of the solved tractions", [press.mae_of_tractions for press in these]),
                ("mean of both heights", [press.mae_of_both for press in these]),
            ):
                yield Figure(f"{name}: {what}, MAE, mean and worst (µm)", f"{np.mean(values):.0f}, {max(values):.0f}")
            for share, values in zip(
                LEAST_LEFT, zip(*(press.mae_of_seen for press in these), strict=True), strict=True
            ):
                what = f"true skin without waves of which scattering leaves less than {share:g}"
                yield Figure(f"{name}: {what}, MAE, mean and worst (µm)", f"{np.mean(values):.0f}, {max(values):.0f}")
        else:
            yield Figure(f"{name}: MAE, mean, and worst, {worst.name} (µm)", f"{mean_mae:.0f}, {worst.mae:.0f}")
        off = np.array([press.deepest_off for press in these])
        stated = np.array([press.stated for press in these])
        near = f"{np.mean([press.is_near for press in these]):.0%} within {NEAR_SHARE:.0%} or {NEAR_UM:.0f} µm"
        spread = f"bias {off.mean():+.0f}, RMS {np.sqrt((off**2).mean()):.0f} µm"
        yield Figure(
            f"{name}: maximum indentation",
            f"{near}, {np.mean(abs(off) <= stated):.0%} within 1 σ, {np.mean(abs(off) <= 2 * stated):.0%} within 2 σ, {spread}",
        )


class StudiedSensor:
    """One sensor, calibrated by `physics` from four images of its own; `quick`: another sensor, which is calibrated sooner."""

    def __init__(self, who: SampledSensor, quick: bool = False) -> None:
        self.who, self.twin = who, who.twin()
        if quick:
            self.made = calibrated("sensor_a", "physics")
        else:
            images = simulate_calibration_images(self.twin, presses=GUIDED_PRESSES, frames=GUIDED_FRAMES)
            self.made = calibrate(CalibrationImages(**vars(images)))
        self.rectify = self.made.rectify

    @cached_property
    def readers(self) -> dict[str, DepthReader]:
        """A reader by each method, from the same images."""
        made, images, rectify = self.made, self.made.images, self.rectify
        untouched = mean_rectified_image([rectify(Frame(self.twin.renderer(None, 100 + n))) for n in range(10)])
        fits = {"physics": made.ball}
        fits |= {name: fit_ball(rectify, *images.ball_pair, made.record.design, name) for name in METHODS}
        return {name: fit.reader(untouched, rectify.height_source) for name, fit in fits.items()}

    def ball_errors(self, presses: int, seed: int) -> dict[str, Errors]:
        """Errors by each reading, means over presses of the other ball."""
        rng = np.random.default_rng(seed)
        pressed = [self._ball_press_errors(rng, 200 + number) for number in range(presses)]
        return {name: Errors(*np.mean([errors[name] for errors in pressed], axis=0)) for name in self.readers}

    def _ball_press_errors(self, rng: np.random.Generator, number: int) -> dict[str, tuple[float, float, float]]:
        """One press somewhere: mean and scatter of the pixels' absolute errors, and that of the deepest point."""
        place = rng.uniform((-7, -4.5), (7, 4.5))
        drag = rng.uniform(-0.25, 0.25, 2)
        press = ScriptedPress(float(rng.uniform(0.5, 1.6)), at_mm=(place[0], place[1]), drag_mm=(drag[0], drag[1]))
        contact = press.simulate(self.twin, OTHER_BALL)
        image = self.rectify(Frame(self.twin.renderer(contact, number)))
        found = {}
        for name, reader in self.readers.items():
            read = reader(image)
            true = true_height_map_like(contact, read, self.who.light.inverse_distance_per_mm)
            off_mm = np.abs(read.z_mm - true.z_mm)[true.z_mm < -DEEPER_THAN_MM]
            deepest = abs(max_indentation_mm(read) - max_indentation_mm(true))
            found[name] = (float(off_mm.mean()), float(off_mm.std()), deepest)
        return found

    def object_presses(self, number: int, count: int) -> Iterator[ObjectPress]:
        """Presses of objects; each sensor has a part of all families, and other objects of them than other sensors."""
        families = [(kind, family) for kind, names in FAMILIES_BY_KIND.items() for family in names]
        step, rng = -(-len(families) // count), np.random.default_rng(1000 + number)
        with TemporaryDirectory() as folder:
            sensor = save_sensor(Path(folder) / "sensor", self.made)
            own, shape, force = sensor.twin(), sensor.shape, sensor.estimator()
        reader = shape.depth_reader(*(Frame(own.renderer(None, 100 + n)) for n in range(10)))
        for kind, family in families[number % step :: step]:
            name, load_n = f"{family}_{number + 1:02d}", float(rng.uniform(*LOADS_N))
            pressed = press_object(own, name, Pose(*rng.uniform(-1, 1, 2), 0.1), load_n)
            if pressed is None:
                continue
            reading = read_frame(Frame(own.renderer(pressed, number)), shape, reader)
            read = reading.height
            true = true_height_map_like(pressed, read, own.renderer.light.inverse_distance_per_mm)
            is_deep = (true.z_mm < -DEEPER_THAN_MM) & read.in_view
            if not is_deep.any():
                continue
            found, deepest = max_indentation_mm(read), max_indentation_mm(true)
            force.forget()
            yield ObjectPress(
                name,
                kind,
                1e3 * float(np.abs(read.z_mm - true.z_mm)[is_deep].mean()),
                1e3 * deepest,
                1e3 * (found - deepest),
                1e3 * reader.max_indentation_error_mm(read),
                *mae_of_tractions_um(force.estimate(reading).traction, read, pressed),
                tuple(
                    1e3
                    * float(
                        np.abs(seen_skin_mm(true, own.renderer.light.point_spread_mm, share) - true.z_mm)[
                            is_deep
                        ].mean()
                    )
                    for share in LEAST_LEFT
                ),
            )


def press_object(twin: Twin, name: str, pose: Pose, load_n: float) -> Contact | None:
    """Return the contact of an object with a load; None for one that does not fit on the gel, or leaves none."""
    indenter, press = indenter_from_name(name), None
    try:
        for part in (0.5, 1.0):
            press = twin.press(press, indenter, pose, load_n * part)
    except (SimulationError, InvalidPose):
        return None
    return press.corrected


def mae_of_tractions_um(traction: Traction | None, read: HeightMap, true: Contact) -> tuple[float, float]:
    """Return the MAE of the skin under tractions, and that of its mean with the heights that are read."""
    assert traction is not None, "expected tractions, got a press without contact"
    upright = orthorectify(read)
    true_mm = true_height_map(true, upright.z_mm.shape, upright.mm_per_px, 0.0).z_mm
    is_deep = (true_mm < -DEEPER_THAN_MM) & upright.in_view
    solved_mm = heights_of_tractions(traction, upright)
    of_tractions, of_both = (
        1e3 * float(np.abs(z_mm - true_mm)[is_deep].mean()) for z_mm in (solved_mm, (solved_mm + upright.z_mm) / 2)
    )
    return of_tractions, of_both


def seen_skin_mm(true: HeightMap, point_spread_mm: float, least_left: float) -> np.ndarray:
    """Return the true skin without the waves of which scattering leaves less than a share, with a soft limit (Wiener's)."""
    rows, cols = (np.pi * np.arange(side) / side / true.mm_per_px for side in true.z_mm.shape)
    left = np.exp(-(point_spread_mm**2) / 2 * (rows[:, None] ** 2 + cols**2))
    return idctn(dctn(true.z_mm) * left**2 / (left**2 + least_left**2))


def heights_of_tractions(traction: Traction, like: HeightMap) -> np.ndarray:
    """Return the height of the skin under tractions at the pixels of an orthorectified map."""
    rows, cols = traction.height_mm.shape
    x, y = skin_grid_mm(like.z_mm.shape, like.mm_per_px)
    at = y / traction.mm_per_px + (rows - 1) / 2, x / traction.mm_per_px + (cols - 1) / 2
    return map_coordinates(traction.height_mm, at, order=3, mode="nearest")


if __name__ == "__main__":
    tyro.cli(reconstruction_study)

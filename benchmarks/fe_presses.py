"""Presses of an independent finite-element gel beside the twin's mechanics and force by physics.

The presses (`--presses`, by default fe/presses.npz beside the real images) were computed with other code: three-dimensional
neo-Hookean bricks at finite strain, Coulomb friction, a gel of 1.973 mm bonded below. For each press the twin's linear mechanics
and its finite-strain correction press the same object to the same pose, and force by physics reads the image that the surface of
the finite elements makes on the twin of the real sensor L. These presses report; nothing is fitted to them.

Presses of two layers (`--two-layers`) tell whether the depth of a ball follows from the thickness of a gel on a base that yields.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro
from force_on_real_fits import calibrate_twin, stated_design
from real_images import REAL, calibrated
from real_sensor_twins import twins_of_real_fits
from scipy.interpolate import griddata

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SENSOR_FILE, SensorFolder, load_sensor
from ninedtact.calibration.sensor_with_other_base import sensor_with_other_base
from ninedtact.calibration.twin.gel_base import KnownBase
from ninedtact.design import Gel
from ninedtact.force.estimator_loading import build_estimator
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.indenter import Ball, Indenter, LyingCylinder
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame, WrenchEstimate
from ninedtact.reading import read_frame
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.twin import Twin
from ninedtact_train.population.sensor_population import SampledSensor

SENSOR = "L"
MODULUS_MPA = 0.093
FE_THICKNESS_MM = 1.973
OBJECTS: dict[str, Indenter] = {"ball4": Ball(4.0), "ball8": Ball(8.0), "cyl5": LyingCylinder(2.5, 10.0)}
LENGTH_UNKNOWN = "cyl5"
"""The length of this cylinder is not stated: only what is read from its surface is compared."""
DEEPEST = "ball4_mid_4"
"""The deepest press of the calibration's ball: 1.4 mm."""
BALL_IMAGE = 77
"""Number of its image, which seeds the noise."""
REFERENCES, STEP_MM = 10, 0.25
TWO_LAYERS, VIEW_PITCH_MM = Gel(2.5, gel_to_base_modulus_ratio=0.1), 0.2


@dataclass(frozen=True)
class FePress:
    """One press of the finite-element gel."""

    name: str
    indenter: Indenter
    pose: Pose
    points_mm: np.ndarray
    """(n, 3) places of the surface nodes after the press."""
    wrench: np.ndarray
    """Six numbers about the skin's centre, N and N·m."""


def fe_presses(
    presses: Path = REAL.parent / "fe/presses.npz",
    two_layers: Path = REAL.parent / "fe/two_layers.npz",
    out: Path = Path("out/force_on_real_fits"),
    ball_of_elements: bool = False,
    quick: bool = False,
) -> None:
    """Print loads and lateral forces over those of the finite elements, and heights where the object presses.

    ball_of_elements: calibrate with the deepest press of the finite elements' ball in place of the twin's. quick: one press, read
    by another sensor, which is calibrated sooner.
    """
    member = twins_of_real_fits()[SENSOR]
    member = replace(member, gel=Gel(FE_THICKNESS_MM, MODULUS_MPA, gel_to_base_modulus_ratio=0.0))
    twin = member.twin()
    folder = out / ("quick" if quick else f"sensor_{SENSOR}_fe{'_ball' if ball_of_elements else ''}")
    if not (folder / SENSOR_FILE).is_file():
        if quick:
            save_sensor(folder, calibrated("sensor_a", "physics"))
        elif ball_of_elements:
            calibrate_on_elements(member, next(one for one in read_presses(presses) if one.name == DEEPEST), folder)
        else:
            calibrate_twin(member, folder)
    sensor = load_sensor(folder)
    base = sensor.record.twin.fit.parameters["gel_to_base_modulus_ratio"]
    print(
        f"calibrated: {sensor.gel.thickness_mm:.3f} mm of gel, modulus over that of its base {base.value:.2f} ± {base.std:.2f}"
    )
    readers = [reader_of(one, twin) for one in (sensor, sensor_with_other_base(sensor, KnownBase(0.0)))]
    print(
        'F_z, and F_xy where dragged: N, and over the finite elements\'; "its base": physics, calibrated with the true base. '
        "Height: RMS of the corrected twin where it is pressed."
    )
    columns = ("linear", "finite", "physics", "its base")
    print(
        f"{'press':14s} {'F_z':>7s} "
        + " ".join(f"{name:>7s}" for name in columns)
        + "    ± |    F_xy  finite  physics | µm"
    )
    deviations = []
    for number, press in enumerate(read_presses(presses)[: 1 if quick else None]):
        linear = press_twin(twin, press)
        finite = correct_for_finite_strain(linear)
        drawn = draw_surface(linear, press)
        read, with_base = (reader(Frame(twin.renderer(drawn, number))) for reader in readers)
        print(row(press, linear, finite, read, with_base, drawn))
        deviations.append(abs(read.wrench.six[2] - press.wrench[2]) / read.std[2])
    within = [sum(deviation < limit for deviation in deviations) for limit in (1, 2)]
    print(f"F_z of {within[0]} and {within[1]} of {len(deviations)} presses is within one and two standard deviations")
    print_depths_from_thickness(two_layers)


def reader_of(sensor: SensorFolder, twin: Twin) -> Callable[[Frame], WrenchEstimate]:
    """Return what estimates the wrench of single images of a twin with the calibration of a sensor."""
    estimator = build_estimator("physics", sensor.shape, replace(sensor.gel, shear_modulus_mpa=MODULUS_MPA))
    references = [Frame(twin.renderer(None, -1 - number)) for number in range(REFERENCES)]
    depth_reader = sensor.shape.depth_reader(*references)

    def read(frame: Frame) -> WrenchEstimate:
        estimator.forget()
        return estimator.estimate(read_frame(frame, sensor.shape, depth_reader))

    return read


def print_depths_from_thickness(path: Path) -> None:
    """Print the depth of a ball on two layers of finite elements, and that which their thickness gives (`BaseDeflection`)."""
    x_mm, y_mm = np.meshgrid(np.arange(-12, 12, VIEW_PITCH_MM), np.arange(-9, 9, VIEW_PITCH_MM))
    deflection = BaseDeflection(TWO_LAYERS)
    with np.load(path) as stored:
        for name in sorted({key.split("/")[0] for key in stored.files}):
            height_mm, interface_mm = (
                griddata(points[:, :2], points[:, 2], (x_mm, y_mm), fill_value=0.0)
                for points in (stored[f"{name}/{part}"].reshape(-1, 3) for part in ("surface", "interface"))
            )
            thicker_mm = (height_mm - interface_mm).astype(np.float32)
            thicker_mm -= np.median(thicker_mm[:2])  # at the border, where nothing moves
            read_mm = thicker_mm + deflection(thicker_mm, VIEW_PITCH_MM)
            print(f"{name}: {-height_mm.min():.3f} mm deep, {-read_mm.min():.3f} mm by its thickness")


def calibrate_on_elements(member: SampledSensor, press: FePress, folder: Path) -> None:
    """Calibrate with the twin's board and with the image of a ball on the finite elements."""
    twin = member.twin()
    images = simulate_calibration_images(twin, member.design, presses=member.presses)
    ball = twin.renderer(draw_surface(press_twin(twin, press), press), BALL_IMAGE)
    calibration = calibrate(CalibrationImages(**{**vars(images), "ball": ball}), stated_design(member, "nothing"))
    save_sensor(folder, calibration)


def read_presses(path: Path) -> list[FePress]:
    """Return the presses of the file, fine meshes left out."""
    with np.load(path) as stored:
        names = sorted({key.rsplit("/", 1)[0] for key in stored.files})
        return [read_press(name, stored) for name in names if not name.startswith("fine")]


def read_press(name: str, stored: np.lib.npyio.NpzFile) -> FePress:
    """Return one press in N, N·m and mm."""
    meta = json.loads(str(stored[f"{name}/meta"]))
    at = meta["pose"]
    pose = Pose(at["x"], at["y"], at["depth"], *np.radians([at["twist"], at["tilt_x"], at["tilt_y"]]).tolist())
    six = stored[f"{name}/wrench"] * MODULUS_MPA * np.array([1, 1, 1, 1e-3, 1e-3, 1e-3])
    return FePress(name, OBJECTS[meta["object"]], pose, stored[f"{name}/surface"].reshape(-1, 3), six)


def press_twin(twin: Twin, press: FePress) -> Contact:
    """Press the same object down to the same depth, then drag it to the same place, by the linear mechanics."""
    start = FIRST_PLACE.get(press.name, (press.pose.x_mm, press.pose.y_mm))
    last = None
    down = replace(press.pose, x_mm=start[0], y_mm=start[1])
    for depth in np.linspace(0, press.pose.depth_mm, int(np.ceil(press.pose.depth_mm / STEP_MM)) + 1)[1:]:
        last = twin.press(last, press.indenter, replace(down, depth_mm=float(depth)))
    return (last if last and down == press.pose else twin.press(last, press.indenter, press.pose)).solved


FIRST_PLACE = {"ball4_light_1": (3.0, -2.0), "ball8_mid_5": (0.0, 0.0), "ball8_off_1": (-6.0, -4.0)}
"""Where the dragged objects came down."""


def draw_surface(contact: Contact, press: FePress) -> Contact:
    """Return the twin's contact with the height of the finite-element surface, at the places where its skin is now."""
    x, y, _ = contact.surface_points_mm
    height = griddata(press.points_mm[:, :2], press.points_mm[:, 2], (x, y), method="cubic", fill_value=0.0)
    return replace(contact, height_mm=height.astype(np.float32))


def row(
    press: FePress,
    linear: Contact,
    finite: Contact,
    read: WrenchEstimate,
    with_base: WrenchEstimate,
    drawn: Contact,
) -> str:
    """Format one press."""
    true, load = press.wrench, press.wrench[2]
    pressed = np.asarray(linear.pressure_mpa) > 0
    height_um = 1e3 * float(
        np.sqrt(np.mean((np.asarray(finite.height_mm) - np.asarray(drawn.height_mm))[pressed] ** 2))
    )
    known = press.indenter is not OBJECTS[LENGTH_UNKNOWN]
    mechanics = [contact.wrench().six[2] / load if known else np.nan for contact in (linear, finite)]
    texts = [
        f"{press.name:14s} {load:7.2f} {mechanics[0]:7.2f} {mechanics[1]:7.2f}",
        f"{read.wrench.six[2] / load:7.2f} {with_base.wrench.six[2] / load:8.2f} {read.std[2] / abs(load):5.2f} |",
    ]
    lateral = float(np.hypot(*true[:2]))
    if press.name in FIRST_PLACE:
        ratios = [float(np.hypot(*six[:2])) / lateral for six in (finite.wrench().six, read.wrench.six)]
        texts.append(f"{lateral:7.2f} {ratios[0]:7.2f} {ratios[1]:8.2f} |")
    else:
        texts.append(f"{'':7s} {'':7s} {'':8s} |")
    height = f"{height_um:6.0f}" if known else f"{'':6s}"
    return " ".join([*texts, f"{height}  {', '.join(read.warnings)}"])


if __name__ == "__main__":
    tyro.cli(fe_presses)

"""Slip, friction and contacts on a real sensor's own twin, at 60 images a second, against what the twin knows.

Objects make the motions of `simulation.object_motions`, which also says what the true state of an image is. A false alarm is a
gross slip while an object is held still, at a depth or under a load, on a gel that relaxes (`mechanics.relaxation`), under a light
that flickers by ±1 %. The hours of holding are made of seconds that are rendered, in any order, about the level at each time.

`--held-out` measures twins of three further real fits, each calibrated from images of its own, in place of A and I.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most
from force_on_real_fits import calibrated_sensor

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.mechanics.height_grid_indenter import indenter_from_heights
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.simulation.object_motions import HZ, MOTION_KINDS, MotionSettings, TrueSlip, play_motion
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.objects.height_fields import CoordinateGrid
from ninedtact.simulation.press import Press
from ninedtact.simulation.twin import Twin
from ninedtact.tracking import ContactTracker, SlipEstimate, SlipEstimator, SlipSample, SlipState, TrackedContacts
from ninedtact.tracking.contact_tracker import CONTACT_CENTRE_STD_MM, load_std_n

SENSORS, HELD_OUT = ("sensor_a", "sensor_i"), ("L", "P", "R")
OBJECTS = (
    ("gear_07", 0.4, 0.3),
    ("ball:5", 0.6, 0.6),
    ("ball:3", 0.9, 0.6),
    ("ellipsoid:6,4,4", 0.5, 0.6),
    ("cross_03", 0.7, 0.3),
    ("torus_02", 0.8, 0.4),
)
"""Objects, their friction and depth in mm; the constants of `tracking.slip` were chosen on the published design with others."""
START_MM, SPEED_MM_S, HELD_DEPTH_MM = (-1.5, -0.4), 6.0, 0.6
ROUND = "ball", "torus"
"""Objects of which no image shows a turn."""
DRAGGED = MOTION_KINDS[:5]
"""Motions without a turn or a tilt."""
STATES = SlipState.STATIC, SlipState.INCIPIENT, SlipState.GROSS
FLICKER, FLICKER_HZ, SETTLING = 0.01, 0.75, 6
HELD_S = np.array([0.0, 1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1200.0])
"""Times of a hold at which the relaxed gel is rendered."""
SEEN_TURN_RAD = 0.05
"""Standard deviation of a turn up to which its torque is measured."""
MOST_FINGERTIPS = 4


@dataclass(frozen=True)
class Torques:
    """The torque about z in N·mm."""

    true: float
    of_image: float
    """What the image alone shows."""
    followed: float
    """With what the turn of the object shows."""
    std: float
    """Stated error of the latter."""


@dataclass(frozen=True)
class Step:
    """One image: the truth, and what was found."""

    truth: TrueSlip
    found: SlipEstimate
    slid_mm: float
    """Distance that the object has slid on the skin since the last gross slip began."""
    torques: Torques | None
    """None where the turn of the object is not seen."""
    by_true_loads: SlipEstimate
    """What is found of the twin's own displacement and loads, the most that `SlipEstimator` can tell."""
    found_in_s: float
    """Processor time."""
    sliding_loads: tuple[float, float] | None
    """While it slides and is found to: F_z over the true one, followed and of the image alone."""


@dataclass
class Rig:
    """A twin under a camera: presses go in, readings come out."""

    sensor: SensorFolder
    friction: float = 1.0

    def __post_init__(self) -> None:
        self.twin: Twin = replace(self.sensor.twin(), friction=self.friction)
        self.reader: DepthReader = self.sensor.shape.depth_reader(
            *(Frame(self.twin.renderer(None, -1 - number)) for number in range(8))
        )
        self.estimator: ForceEstimator = self.sensor.estimator("physics")

    def read(self, press: Press, number: int, light: float = 1.0) -> Reading:
        """Return the reading of a press."""
        renderer = self.twin.renderer
        image = renderer.noise.add_to(renderer.render_without_noise(press.corrected) * np.float32(light), number)
        frame = Frame(image, round((number + 1) * 1e9 / HZ), number)
        return self.estimator.add_force(read_frame(frame, self.sensor.shape, self.reader))


def follow(rig: Rig, indenter: Indenter, settings: MotionSettings, kind: str) -> Iterator[Step]:
    """Yield what is true and what is found while an object moves."""
    tracker, judge, slid_mm = ContactTracker(), SlipEstimator(), 0.0
    rig.estimator.forget()
    for number, step in enumerate(play_motion(rig.twin, indenter, settings.motion(kind))):
        truth = step.slip
        slid_mm = slid_mm + truth.speed_mm_s / HZ if truth.state == SlipState.GROSS else 0.0
        reading = rig.read(step.press, number)
        began = process_time()
        found = tracker.update(reading)
        spent_s = process_time() - began
        pose, force_n = step.press.pose, step.press.wrench.force_n
        by_true_loads = judge.update(sample_of(np.array([pose.x_mm, pose.y_mm, *force_n]), number))
        loads = sliding_loads(step.press, reading, found) if truth.state == SlipState.GROSS else None
        yield Step(truth, found.slip, slid_mm, torques(step.press, reading, found), by_true_loads, spent_s, loads)


def sample_of(row: np.ndarray, number: int) -> SlipSample:
    """Return the sample of an image: displacement along x and y, and force."""
    return SlipSample((number + 1) / HZ, row[:2], row[2:4], -float(row[4]), CONTACT_CENTRE_STD_MM, load_std_n(row[4]))


def torques(press: Press, reading: Reading, found: TrackedContacts) -> Torques | None:
    """Return the torques of one image; None where no torque is seen in the turn of the object."""
    alone, followed = reading.force, found.reading.force
    if alone is None or followed is None or not found.contacts or not 0 < found.motion.std[5] < SEEN_TURN_RAD:
        return None
    alone, followed = alone.about_skin_centre(), followed.about_skin_centre()
    numbers = press.wrench.six[5], alone.wrench.six[5], followed.wrench.six[5], followed.std[5]
    return Torques(*(1e3 * float(number) for number in numbers))


def sliding_loads(press: Press, reading: Reading, found: TrackedContacts) -> tuple[float, float] | None:
    """Return F_z over the true one, followed and of the image alone; None where gross slip is not found."""
    alone, followed = reading.wrench, found.reading.wrench
    if alone is None or followed is None or found.slip.state != SlipState.GROSS:
        return None
    true_n = press.wrench.force_n[2]
    return float(followed.force_n[2] / true_n), float(alone.force_n[2] / true_n)


def torque_figures(name: str, twists: Sequence[Sequence[Step]]) -> Iterator[Figure]:
    """Yield the errors of the torque of twists whose turn is seen, over the torque: root mean squares over all images."""
    seen = [one for steps in twists for step in steps if (one := step.torques) is not None]
    if not seen:
        return
    true, alone, followed, std = np.array([[one.true, one.of_image, one.followed, one.std] for one in seen]).T
    errors = [float(np.sqrt(np.mean((of - true) ** 2) / np.mean(true**2))) for of in (alone, followed)]
    within = [float(np.mean(np.abs(followed - true) < times * std)) for times in (1, 2)]
    label = f"{name}: twists whose turn is seen in {len(seen)} of {sum(map(len, twists))} images, error of T_z over T_z"
    yield Figure(f"{label}: followed; of the image alone", errors[1], peer=errors[0])
    yield Figure(f"{label}: followed, within 1σ, 2σ", f"{within[0]:.2f}, {within[1]:.2f}")


@dataclass(frozen=True)
class Hold:
    """Displacement and force of an object that moves to its last pose and is held there."""

    moving: np.ndarray
    """The images until then, (n, 5)."""
    periods: np.ndarray
    """Periods of a light that flickers, less their mean, (periods, images, 5)."""
    levels: np.ndarray
    """The mean at each of `HELD_S`, (times, 5)."""

    def after(self, seconds: float, seed: int) -> np.ndarray:
        """Return a hold of this length, of periods in any order."""
        rng, images = np.random.default_rng(seed), round(seconds * HZ)
        order = rng.integers(0, len(self.periods), images // self.periods.shape[1] + 1)
        noise = np.concatenate(self.periods[order])[:images]
        times = np.log1p(np.arange(images) / HZ)
        crept = [np.interp(times, np.log1p(HELD_S), level) for level in self.levels.T]
        return np.concatenate([self.moving, noise + np.stack(crept, axis=1)])


def hold(rig: Rig, indenter: Indenter, poses: list[Pose], periods: int, is_load_held: bool) -> Hold:
    """Return the hold of an object at its last pose, or under the load that it has there."""
    tracker, last, rows, images = ContactTracker(), None, list[np.ndarray](), round(HZ / FLICKER_HZ)
    rig.estimator.forget()

    def see(press: Press, light: float) -> np.ndarray:
        reading = rig.read(press, len(rows), light)
        found = tracker.update(reading)
        force_n = np.zeros(3) if reading.wrench is None else reading.wrench.force_n
        rows.append(np.concatenate([found.displacement_mm, force_n]))
        return rows[-1]

    for pose in poses:
        last = rig.twin.press(last, indenter, pose, after_s=1 / HZ)
        see(last, 1.0)
    assert last is not None
    flicker = 1 + FLICKER * np.sin(2 * np.pi * np.arange(periods * images + SETTLING) / images)
    held = np.array([see(last, float(light)) for light in flicker])[SETTLING:]
    levels, load_n = [held.mean(axis=0)], float(last.load_n) if is_load_held else None
    for after_s in np.diff(HELD_S):
        last = rig.twin.press(last, indenter, last.pose, load_n, after_s=float(after_s))
        levels.append(np.mean([see(last, 1.0) for _ in range(4)], axis=0))
    periods_of_hold = (held - levels[0]).reshape(periods, images, -1)
    return Hold(np.array(rows[: len(poses)]), periods_of_hold, np.array(levels))


def alarms_in_hold(rows: np.ndarray, moving: int) -> int:
    """Return the number of gross slips after an object has come to rest."""
    estimator, alarms, was_gross = SlipEstimator(), 0, False
    for number, row in enumerate(rows):
        found = estimator.update(sample_of(row, number))
        alarms += found.state == SlipState.GROSS and not was_gross and number > moving + SETTLING
        was_gross = found.state == SlipState.GROSS
    return alarms


@dataclass(frozen=True)
class Fingertips:
    """Balls that are pressed together: their forces by the twin and as found, and in how many images their number was right."""

    true_n: np.ndarray
    found_n: np.ndarray
    right: int
    images: int


def press_fingertips(rig: Rig, presses: int, seed: int) -> Fingertips:
    """Press one to four balls at once, at random places and heights, and drag them."""
    rng, true_n, found_n, right, images = np.random.default_rng(seed), [], [], 0, 0
    for number in range(presses):
        indenter, centres_mm = fingertips(rng, 1 + number % MOST_FINGERTIPS)
        depth_mm, (x_mm, y_mm), last = float(rng.uniform(0.5, 0.9)), rng.uniform(-0.6, 0.6, 2), None
        middle_mm = (centres_mm.min(axis=0) + centres_mm.max(axis=0)) / 2
        rig.estimator.forget()
        for part in (0.0, 0.5, 1.0):
            offset_mm = np.array([part * x_mm, part * y_mm])
            last = rig.twin.press(last, indenter, Pose(*(middle_mm + offset_mm).tolist(), depth_mm))
            found = rig.read(last, images).contacts
            images += 1
            if len(found) != len(centres_mm):
                continue
            right += 1
            contact = last.corrected
            places = contact.surface_points_mm[:2]
            distances = [np.hypot(*(places - centre[:, None, None])) for centre in centres_mm + offset_mm]
            owner = np.argmin(distances, axis=0)
            for which, centre in enumerate(centres_mm + offset_mm):
                tractions = np.concatenate([contact.shear_mpa, -contact.pressure_mpa[None]]) * (owner == which)
                true_n.append(tractions.sum(axis=(1, 2)) * contact.skin.grid.cell_area_mm2)
                away_mm = [float(np.linalg.norm(one.centre_mm - centre)) for one in found]
                share = found[int(np.argmin(away_mm))].force
                found_n.append(np.full(3, np.nan) if share is None else share.wrench.force_n)
    return Fingertips(np.array(true_n), np.array(found_n), right, images)


def fingertips(rng: np.random.Generator, count: int) -> tuple[Indenter, np.ndarray]:
    """Return balls beside each other as one object, and their centres."""
    radius_mm, centres = float(rng.uniform(2.5, 4.5)), list[np.ndarray]()
    while len(centres) < count:
        centre = rng.uniform((-8, -5), (8, 5))
        if all(np.linalg.norm(centre - other) > 1.9 * radius_mm for other in centres):
            centres.append(centre)
        elif rng.uniform() < 0.02:
            centres = []
    grid, heights = CoordinateGrid(28.0), np.full(CoordinateGrid(28.0).x.shape, np.inf)
    higher_mm = rng.uniform(0, 0.25, count)
    for (x_mm, y_mm), higher in zip(centres, higher_mm - higher_mm.min(), strict=True):
        squared = (grid.x - x_mm) ** 2 + (grid.y - y_mm) ** 2
        ball = radius_mm - np.sqrt(np.maximum(radius_mm**2 - squared, 0)) + higher
        heights = np.where(squared < 0.8 * radius_mm**2, np.minimum(heights, ball), heights)
    return indenter_from_heights("fingertips", heights, grid.pitch_mm), np.array(centres)


@dataclass(frozen=True)
class Onset:
    """A gross slip: how much later it was noticed than it began, and how far the object had slid then; infinite where never."""

    late_ms: float
    slid_mm: float


def onsets(steps: Sequence[Step]) -> list[Onset]:
    """Return the gross slips of a sequence that last four images at least."""
    true, found = (
        [state == SlipState.GROSS for state in states] for states in zip(*map(states_of, steps), strict=True)
    )
    noticed, number = [], 1
    while number < len(true):
        end = number
        while end < len(true) and true[end]:
            end += 1
        if not true[number - 1] and end - number >= 4:
            first = next((at for at in range(number, end) if found[at]), None)
            if first == number:
                while first > 0 and found[first - 1]:
                    first -= 1
            late = Onset(np.inf, np.inf)
            if first is not None:
                late = Onset((first - number) * 1e3 / HZ, steps[first].slid_mm)
            noticed.append(late)
        number = max(end, number + 1)
    return noticed


def states_of(step: Step) -> tuple[SlipState, SlipState]:
    """Return the true state and the state that was found."""
    return SlipState(step.truth.state), step.found.state


def confusion(sequences: Sequence[Sequence[Step]], by_true_loads: bool = False) -> np.ndarray:
    """Return the number of images by true state (rows) and found state (columns); unknown counts as static."""
    counts = np.zeros((3, 3), int)
    for step in (step for steps in sequences for step in steps):
        true, found = states_of(step)
        found = step.by_true_loads.state if by_true_loads else found
        if true in STATES:
            counts[STATES.index(true), STATES.index(found) if found in STATES else 0] += 1
    return counts


def f1_scores(counts: np.ndarray) -> np.ndarray:
    """Return 2·right / (true + found) of every state."""
    return 2 * np.diag(counts) / np.maximum(counts.sum(axis=0) + counts.sum(axis=1), 1)


@dataclass(frozen=True)
class FrictionError:
    """The relative error of friction after 2 mm of slip."""

    error: float
    stated: float
    """Its standard deviation as it is stated."""
    by_true_loads: float
    """The error of what is found of the twin's own loads."""


def friction_error(steps: Sequence[Step], friction: float) -> FrictionError | None:
    """Return the error of friction after 2 mm of slip; None where the object did not slide so far."""
    after_mm = 0.0
    for step in steps:
        after_mm += step.truth.speed_mm_s / HZ if step.truth.state == SlipState.GROSS else 0.0
        found, best = step.found, step.by_true_loads
        if after_mm > 2 and np.isfinite(found.friction) and np.isfinite(best.friction):
            return FrictionError(
                found.friction / friction - 1, found.friction_std / friction, best.friction / friction - 1
            )
    return None


def slip(
    out: Path = Path("out/own_twin_presses"), held_out: bool = False, quick: bool = False, json: bool = False
) -> None:
    """Let every object slip on every sensor."""
    figures: list[Figure] = []
    for name in (HELD_OUT if held_out else SENSORS)[: 1 if quick else None]:
        figures += measure(name, calibrated_sensor(name, out), quick)
    answer("Slip, friction and contacts on a sensor's own twin", figures, json)


def measure(name: str, sensor: SensorFolder, quick: bool) -> list[Figure]:
    """Return the figures of one sensor."""
    sequences, turned = list[list[Step]](), dict[tuple[str, str], list[Step]]()
    errors, spent_s = list[FrictionError](), 0.0
    for item, friction, depth_mm in OBJECTS[: 1 if quick else None]:
        rig, indenter = Rig(sensor, friction), indenter_from_name(item)
        settings = MotionSettings(Pose(*START_MM, depth_mm), SPEED_MM_S, friction)
        for kind in ("slide", "twist") if quick else MOTION_KINDS:
            steps = list(follow(rig, indenter, settings, kind))
            spent_s += sum(step.found_in_s for step in steps)
            if kind in DRAGGED:
                sequences.append(steps)
            else:
                turned[item, kind] = steps
            error = friction_error(steps, friction)
            errors += [] if error is None else [error]
    counts = confusion(sequences)
    late = [onset for steps in sequences for onset in onsets(steps)]
    hours, alarms = measure_false_alarms(sensor, quick)
    tips = press_fingertips(Rig(sensor), 2 if quick else 48, seed=0)
    skill = 1 - ((tips.found_n - tips.true_n) ** 2).sum(axis=0) / ((tips.true_n - tips.true_n.mean(axis=0)) ** 2).sum(
        axis=0
    )
    names = [f"{state} {share:.2f}" for state, share in zip(STATES, f1_scores(counts), strict=True)]
    return [
        at_least(f"{name}: macro-F1 of static, incipient, gross", float(f1_scores(counts).mean()), 0.85, peer=0.53),
        Figure(f"{name}: F1", ", ".join(names)),
        *turned_figures(name, turned),
        *torque_figures(name, [steps for (_, kind), steps in turned.items() if kind == "twist"]),
        Figure(f"{name}: images by true state, as static, incipient, gross", "; ".join(str(row) for row in counts)),
        at_most(
            f"{name}: onset of gross slip noticed after, median",
            float(np.median([one.late_ms for one in late])),
            34,
            "ms",
        ),
        at_least(
            f"{name}: {len(late)} onsets, noticed before 1 mm of slip",
            float(np.mean([one.slid_mm < 1 for one in late])),
            0.95,
        ),
        Figure(
            f"{name}: onsets stated more than 100 ms too early", float(np.mean([one.late_ms < -100 for one in late]))
        ),
        at_most(f"{name}: false alarms in {hours:.2g} hours of holding", alarms, 0),
        *friction_figures(name, errors),
        load_figure(name, sequences),
        at_least(f"{name}: 1 to 4 fingertips, number right", tips.right / tips.images, 0.98),
        at_least(f"{name}: skill of F_z of each fingertip", float(skill[2]), 0.85),
        Figure(
            f"{name}: load of a ball over the true one, at once and held for 20 min",
            ", ".join(f"{ratio:.2f}" for ratio in held_load_ratios(sensor)),
        ),
        Figure(f"{name}: skill of F_x, F_y of each fingertip", f"{skill[0]:.3f}, {skill[1]:.3f}"),
        Figure(
            f"{name}: contacts, motion and slip, ms of processor time",
            1e3 * spent_s / sum(map(len, [*sequences, *turned.values()])),
        ),
    ]


def turned_figures(name: str, turned: dict[tuple[str, str], list[Step]]) -> Iterator[Figure]:
    """Yield the scores of twists, rolls and regrasps, and of those that leave a trace in the images."""
    seen = [steps for (item, kind), steps in turned.items() if kind != "twist" or not item.startswith(ROUND)]
    again = [steps for (_, kind), steps in turned.items() if kind == "regrasp"]
    what = f"{name}: macro-F1 of twist, roll and regrasp"
    yield Figure(what, float(f1_scores(confusion(list(turned.values()))).mean()))
    yield Figure(f"{what}, without twists of balls and rings", float(f1_scores(confusion(seen)).mean()))
    both = (float(f1_scores(confusion(again, by_true_loads)).mean()) for by_true_loads in (False, True))
    yield Figure(f"{name}: macro-F1 of regrasps; by the twin's own loads", ", ".join(f"{score:.2f}" for score in both))


def load_figure(name: str, sequences: Sequence[Sequence[Step]]) -> Figure:
    """Return the error of the load while objects slide: mean over all images."""
    loads = np.array([step.sliding_loads for steps in sequences for step in steps if step.sliding_loads])
    followed, alone = np.abs(loads - 1).mean(axis=0).tolist()
    return Figure(f"{name}: load while it slides, mean error followed; of the image alone", followed, peer=alone)


def friction_figures(name: str, errors: list[FrictionError]) -> Iterator[Figure]:
    """Yield the errors of friction, and whether the stated ones contain them."""
    found, best = (np.array([getattr(one, part) for one in errors] or [0.0]) for part in ("error", "by_true_loads"))
    yield at_most(f"{name}: friction after 2 mm, largest error", float(np.abs(found).max()), 0.1)
    yield Figure(f"{name}: friction after 2 mm, mean error", float(found.mean()))
    deviations = np.abs(found) / np.array([one.stated for one in errors] or [1.0])
    within = ", ".join(f"{(deviations < most).mean():.2f}" for most in (1, 2))
    yield Figure(f"{name}: friction within one and two standard deviations", within)
    yield Figure(f"{name}: friction by the twin's own loads, largest error", float(np.abs(best).max()))


def held_load_ratios(sensor: SensorFolder) -> tuple[float, float]:
    """Return the load that is read of a ball over the true one: at once, and after it was held for 20 minutes."""
    rig, indenter, pose = Rig(sensor), indenter_from_name("ball:5"), Pose(depth_mm=HELD_DEPTH_MM)
    press = rig.twin.press(None, indenter, pose)
    held = rig.twin.press(press, indenter, pose, after_s=float(HELD_S[-1]))
    read_n = [float(rig.estimator.estimate(rig.read(one, 0)).wrench.force_n[2]) for one in (press, held)]
    return read_n[0] / float(press.wrench.force_n[2]), read_n[1] / float(held.wrench.force_n[2])


def measure_false_alarms(sensor: SensorFolder, quick: bool) -> tuple[float, int]:
    """Return the hours of holding, and the gross slips in them.

    Objects are pressed, dragged half-way, or have slid, and are held at their depth or under their load.
    """
    rig, indenter = Rig(sensor, 0.6), indenter_from_name("ball:5")
    there = MotionSettings(Pose(*START_MM, HELD_DEPTH_MM), SPEED_MM_S, 0.6).poses("slide")
    seconds, alarms = 3.0 if quick else HELD_S[-1], 0
    holds = [(end, is_load_held) for end in (22, 28, len(there)) for is_load_held in (False, True)]
    for number, (end, is_load_held) in enumerate(holds[: 1 if quick else None]):
        found = hold(rig, indenter, there[:end], 1 if quick else 6, is_load_held)
        alarms += alarms_in_hold(found.after(seconds, number), end)
    return (1 if quick else len(holds)) * seconds / 3600, alarms


if __name__ == "__main__":
    tyro.cli(slip)

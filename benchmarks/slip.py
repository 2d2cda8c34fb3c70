"""Slip, friction and contacts on a real sensor's own twin, at 60 images a second, against what the twin knows.

Objects are pressed and dragged until they slide, dragged back, dragged and stopped again and again, pressed deeper on the way, and
hung in a grip that weakens. The true state of an image is gross where less than 2 % of the contact sticks and it slides at more
than 0.5 mm/s, incipient where less than 0.7 of the contact sticks, otherwise static. A false alarm is a gross slip while an object
is held still, under a light that flickers by ±1 %, and loads that fall by a tenth in an hour as gel creeps. An hour of holding is
made of seconds that are rendered, in any order.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from time import process_time

import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most
from real_images import calibrated

from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.force.estimator_and_scale import ForceEstimator
from ninedtact.mechanics.height_grid_indenter import indenter_from_heights
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose, rigid_displacement_mm
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.calibrated_shape import DepthReader
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.objects.height_fields import CoordinateGrid
from ninedtact.simulation.twin import Press, Twin
from ninedtact.tracking import ContactTracker, SlipEstimator, SlipState, TrackedContacts
from ninedtact.tracking.contact_tracker import CONTACT_CENTRE_STD_MM, load_std_n

SENSORS = "sensor_a", "sensor_i"
OBJECTS = (
    ("ball:5", 0.6, 0.6),
    ("ball:3", 0.9, 0.6),
    ("ellipsoid:6,4,4", 0.5, 0.6),
    ("gear_07", 0.4, 0.3),
    ("cross_03", 0.7, 0.3),
    ("torus_02", 0.8, 0.4),
)
"""Objects, their friction and depth in mm; the constants of `tracking.slip` were chosen on the published design with others."""
HZ, HELD_DEPTH_MM = 60.0, 0.6
SLIDES_ABOVE_MM_PER_S, SLIDES_BELOW_SHARE, INCIPIENT_BELOW_SHARE = 0.5, 0.02, 0.7
STATES = SlipState.STATIC, SlipState.INCIPIENT, SlipState.GROSS
FLICKER, FLICKER_HZ, CREEP, SETTLING = 0.01, 0.75, 0.1, 6
MOST_FINGERTIPS = 4


@dataclass(frozen=True)
class Truth:
    """What the twin knows of one image."""

    state: SlipState
    sticking_share: float
    speed: float
    """mm/s."""


@dataclass(frozen=True)
class Step:
    """One image: the truth, and what was found."""

    truth: Truth
    found: TrackedContacts
    force_n: np.ndarray
    slid_mm: float
    """Distance that the object has slid on the skin since the last gross slip began."""
    found_in_s: float
    """Processor time."""


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


Motion = Callable[[Press | None], Pose | None]
"""Returns the next pose from the last press; None at the end."""


def motions(depth_mm: float, speed: float, friction: float) -> dict[str, list[Pose] | Motion]:
    """Return the poses of every kind of motion. speed: mm/s."""
    start = Pose(-1.5, -0.4, depth_mm)
    pressed = [replace(start, depth_mm=depth_mm * min(1.0, (number + 1) / 10)) for number in range(22)]
    there = pressed + drag(pressed[-1], 2.6, speed)
    back = there + [there[-1]] * 6
    back += drag(back[-1], -2.6, speed)
    jerky = list(pressed)
    for _ in range(5):
        jerky += drag(jerky[-1], 0.6, speed)
        jerky += [jerky[-1]] * 8
    tighter = pressed + drag(pressed[-1], 0.6, speed)
    deep = 1.3 * depth_mm
    tighter += [tighter[-1].interpolate(replace(tighter[-1], depth_mm=deep), (step + 1) / 20) for step in range(20)]
    tighter += drag(tighter[-1], 1.8, speed)
    return {
        "there": there + [there[-1]] * 10,
        "back": back,
        "jerky": jerky,
        "tighter": tighter,
        "hanging": hanging_load(pressed, friction),
    }


def drag(last: Pose, by_mm: float, speed: float) -> list[Pose]:
    """Return the poses of a drag along a direction of 17°."""
    count = max(round(abs(by_mm) * HZ / speed), 1)
    end = replace(last, x_mm=last.x_mm + by_mm, y_mm=last.y_mm + 0.3 * by_mm)
    return [last.interpolate(end, (number + 1) / count) for number in range(count)]


def hanging_load(pressed: list[Pose], friction: float) -> Motion:
    """Return the motion of an object that hangs in a grip: it moves until the skin bears its weight, while the grip weakens.

    Its weight is 0.6 of what friction bears at first. It falls at 8 mm/s at most.
    """
    number, weight_n, depth_mm = 0, 0.0, pressed[-1].depth_mm

    def move(last: Press | None) -> Pose | None:
        nonlocal number, weight_n
        number += 1
        if number <= len(pressed) or last is None:
            return pressed[number - 1]
        weight_n = weight_n or 0.6 * friction * float(last.load_n)
        missing_n = weight_n - float(last.wrench.force_n[0])
        # A load that is borne to 3 % holds it: smaller steps would be less than the tolerance of the twin's solver.
        step_mm = float(np.clip(0.5 * missing_n, 0.0, 8 / HZ)) if missing_n > 0.03 * weight_n else 0.0
        weakening = np.clip((number - 50) / 60, 0, 0.7)
        pose = replace(last.pose, x_mm=last.pose.x_mm + step_mm, depth_mm=depth_mm * (1 - float(weakening)))
        return pose if number < 110 and pose.x_mm < 2.5 else None

    return move


def follow(rig: Rig, indenter: Indenter, motion: list[Pose] | Motion) -> Iterator[Step]:
    """Yield what is true and what is found while an object moves."""
    tracker, last, slid_mm = ContactTracker(), None, 0.0
    rig.estimator.forget()
    for number in count():
        pose = motion(last) if callable(motion) else motion[number] if number < len(motion) else None
        if pose is None:
            return
        press = rig.twin.press(last, indenter, pose)
        truth = true_slip(last, press)
        slid_mm = slid_mm + truth.speed / HZ if truth.state == SlipState.GROSS else 0.0
        reading = rig.read(press, number)
        force_n = np.zeros(3) if reading.wrench is None else reading.wrench.force_n
        began = process_time()
        found = tracker.update(reading)
        yield Step(truth, found, force_n, slid_mm, process_time() - began)
        last = press


def true_slip(last: Press | None, press: Press) -> Truth:
    """Return the true state: the share that sticks, and how fast the skin's points move under the object."""
    if last is None or press.slip_share is None:
        return Truth(SlipState.UNKNOWN if press.slip_share is None else SlipState.STATIC, 1.0, 0.0)
    before, now = last.solved, press.solved
    positions = now.skin.positions_mm
    origin = replace(before.pose, x_mm=0.0, y_mm=0.0)
    moved = replace(now.pose, x_mm=now.pose.x_mm - before.pose.x_mm, y_mm=now.pose.y_mm - before.pose.y_mm)
    carried = before.tangential_mm + rigid_displacement_mm(origin, moved, positions)
    weight = np.where(before.pressure_mpa > 0, now.pressure_mpa, 0)
    slid = carried - now.tangential_mm
    speed = HZ * float(np.linalg.norm((weight * slid).sum(axis=(1, 2)) / max(weight.sum(), 1e-12)))
    share = 1 - press.slip_share
    if share < SLIDES_BELOW_SHARE and speed > SLIDES_ABOVE_MM_PER_S:
        return Truth(SlipState.GROSS, share, speed)
    return Truth(SlipState.INCIPIENT if share < INCIPIENT_BELOW_SHARE else SlipState.STATIC, share, speed)


def hold(rig: Rig, indenter: Indenter, poses: list[Pose], images: int) -> np.ndarray:
    """Return displacement and force in every image of an object that moves to its last pose and is held there, under light that
    flickers."""
    tracker, last, rows = ContactTracker(), None, []
    rig.estimator.forget()
    for number, pose in enumerate(poses + [poses[-1]] * images):
        if number < len(poses):
            last = rig.twin.press(last, indenter, pose)
        assert last is not None
        is_held = number >= len(poses)
        phase = 2 * np.pi * FLICKER_HZ * number / HZ
        reading = rig.read(last, number, 1 + is_held * FLICKER * float(np.sin(phase)))
        found = tracker.update(reading)
        force_n = np.zeros(3) if reading.wrench is None else reading.wrench.force_n
        rows.append(np.concatenate([found.displacement_mm, force_n]))
    return np.array(rows)


def alarms_in_hold(rows: np.ndarray, moving: int, seconds: float, seed: int) -> int:
    """Return the number of gross slips in a long hold: periods of flicker of a short one in any order, while the load creeps."""
    rng, estimator, alarms, was_gross = np.random.default_rng(seed), SlipEstimator(), 0, False
    held = rows[moving + SETTLING :]
    period = round(HZ / FLICKER_HZ)
    blocks = rng.integers(0, len(held) // period, round(seconds * FLICKER_HZ))
    order = np.concatenate([np.arange(period) + period * block for block in blocks])
    level = held.mean(axis=0)
    for number, row in enumerate(np.concatenate([rows[:moving], held[order]])):
        after_s = max(number - moving, 0) / HZ
        crept = 1 - CREEP * np.log1p(after_s / 10) / np.log1p(360)
        row = row + (crept - 1) * np.concatenate([np.zeros(2), level[2:]])
        found = estimator.update(number / HZ, row[:2], CONTACT_CENTRE_STD_MM, row[2:4], -row[4], load_std_n(row[4]))
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
    return step.truth.state, step.found.slip.state


def confusion(sequences: Sequence[Sequence[Step]]) -> np.ndarray:
    """Return the number of images by true state (rows) and found state (columns); unknown counts as static."""
    counts = np.zeros((3, 3), int)
    for step in (step for steps in sequences for step in steps):
        true, found = states_of(step)
        if true in STATES:
            counts[STATES.index(true), STATES.index(found) if found in STATES else 0] += 1
    return counts


def f1_scores(counts: np.ndarray) -> np.ndarray:
    """Return 2·right / (true + found) of every state."""
    return 2 * np.diag(counts) / np.maximum(counts.sum(axis=0) + counts.sum(axis=1), 1)


def friction_error(steps: Sequence[Step], friction: float) -> float | None:
    """Return the relative error of friction after 2 mm of slip; None where the object did not slide so far."""
    after_mm = 0.0
    for step in steps:
        after_mm += step.truth.speed / HZ if step.truth.state == SlipState.GROSS else 0.0
        if after_mm > 2 and np.isfinite(step.found.slip.friction):
            return step.found.slip.friction / friction - 1
    return None


def slip(out: Path = Path("out/own_twin_presses"), quick: bool = False, json: bool = False) -> None:
    """Let every object slip on every sensor."""
    figures: list[Figure] = []
    for name in SENSORS[: 1 if quick else None]:
        if not (out / name).is_dir():
            save_sensor(out / name, calibrated(name, "physics"))
        figures += measure(name, load_sensor(out / name), quick)
    answer("Slip, friction and contacts on a sensor's own twin", figures, json)


def measure(name: str, sensor: SensorFolder, quick: bool) -> list[Figure]:
    """Return the figures of one sensor."""
    sequences, errors, spent_s = list[list[Step]](), list[float](), 0.0
    for item, friction, depth_mm in OBJECTS[: 1 if quick else None]:
        rig, indenter = Rig(sensor, friction), indenter_from_name(item)
        kinds = motions(depth_mm, 6.0, friction)
        for kind in ("there",) if quick else kinds:
            steps = list(follow(rig, indenter, kinds[kind]))
            spent_s += sum(step.found_in_s for step in steps)
            sequences.append(steps)
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
        at_most(f"{name}: friction after 2 mm, largest error", float(np.abs(errors).max(initial=0.0)), 0.1),
        Figure(f"{name}: friction after 2 mm, mean error", float(np.mean(errors or [0.0]))),
        at_least(f"{name}: 1 to 4 fingertips, number right", tips.right / tips.images, 0.98),
        at_least(f"{name}: skill of F_z of each fingertip", float(skill[2]), 0.85),
        Figure(f"{name}: skill of F_x, F_y of each fingertip", f"{skill[0]:.3f}, {skill[1]:.3f}"),
        Figure(f"{name}: contacts, motion and slip, ms of processor time", 1e3 * spent_s / sum(map(len, sequences))),
    ]


def measure_false_alarms(sensor: SensorFolder, quick: bool) -> tuple[float, int]:
    """Return the hours of holding, and the gross slips in them: pressed, dragged half-way, and after a slide."""
    rig, indenter = Rig(sensor, 0.6), indenter_from_name("ball:5")
    kinds = motions(HELD_DEPTH_MM, 6.0, 0.6)
    seconds, alarms = 3.0 if quick else 1200.0, 0
    there = kinds["there"]
    assert isinstance(there, list)
    ends = (22, 28, len(there))[: 1 if quick else None]
    for number, end in enumerate(ends):
        rows = hold(rig, indenter, there[:end], round((2 if quick else 12) * HZ))
        alarms += alarms_in_hold(rows, end, seconds, number)
    return len(ends) * seconds / 3600, alarms


if __name__ == "__main__":
    tyro.cli(slip)

"""Which cause `ninedtact check` and `ninedtact calibrate` name for images with one known fault.

Images of real sensors, and of twins of real fits and of the population, are edited: each cause at several strengths. *check*
compares one edited reference image with the calibration's images (every sensor has the lens of sensor A). *calibrate* gets four
images with a fault in some of them; what the images alone tell is asked for, which needs no fit; wrong lengths have a
benchmark of their own. An answer is *right*, *wrong*, or *unknown*: nothing is named, or the report says that it cannot be
observed. Strengths in `UNSEEN` were drawn after all limits had been chosen, and are counted apart as well.
"""

from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least
from real_images import calibrated, calibration_images, sensor_folders
from real_sensor_twins import twins_of_real_fits

from ninedtact.calibration.diagnosis import find_image_cause
from ninedtact.calibration.drift.diagnosis import diagnose_drift
from ninedtact.calibration.drift.measurement import CalibratedReference, measure_drift
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact_train.population.sensor_population import sample_sensor

RIGHT_SHARE = 0.9
REFERENCES, PAIRS = (
    ("board_reference", "ball_reference"),
    (("board_reference", "board"), ("ball_reference", "ball")),
)
Image = np.ndarray
Edit = Callable[[Image], Image]


def whole_levels(image: Image) -> Image:
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def noise_of(image: Image, sigma: float) -> Image:
    """Return noise that is another one for every image: what two images share is taken for their skin."""
    return np.random.default_rng(int(image.sum())).normal(0, sigma, image.shape)


def light(image: Image, gain: object = 1.0, gamma: float = 1.0) -> Image:
    return whole_levels(255 * (image / 255) ** gamma * np.asarray(gain))


def blur(image: Image, sigma_px: float, noise: float = 0.0) -> Image:
    soft = cv2.GaussianBlur(image.astype(np.float32), (0, 0), sigma_px)
    return whole_levels(soft + noise_of(image, noise))


def move(image: Image, x: float, y: float, clockwise_deg: float = 0.0) -> Image:
    rows, cols = image.shape[:2]
    matrix = cv2.getRotationMatrix2D(((cols - 1) / 2, (rows - 1) / 2), -clockwise_deg, 1)
    matrix[:, 2] += x, y
    there = cv2.warpAffine(image.astype(np.float32), matrix, (cols, rows), borderMode=cv2.BORDER_REFLECT)
    return whole_levels(there + noise_of(image, 0.5))


def flip(image: Image, code: int) -> Image:
    return np.ascontiguousarray(cv2.flip(image, code))


def spot(image: Image, change: float, radius_px: float, x: int = 180, y: int = 150) -> Image:
    rows, cols = np.indices(image.shape[:2])
    inside = 1 / (1 + np.exp(np.hypot(cols - x, rows - y) - radius_px))
    return whole_levels(image * (1 + change * inside[..., None]))


def failed_led(image: Image, part: float, at: tuple[int, int] = (0, 240), reach_px: float = 130.0) -> Image:
    rows, cols = np.indices(image.shape[:2])
    shade = np.exp(-((cols - at[0]) ** 2 + (rows - at[1]) ** 2) / 2 / reach_px**2)
    return whole_levels(image * (1 - part * shade)[..., None])


def jpeg(image: Image, quality: int) -> Image:
    return np.asarray(
        cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], cv2.IMREAD_COLOR)
    )


def noisy(image: Image, sigma: float) -> Image:
    return whole_levels(image + noise_of(image, sigma))


EDITS: dict[str, dict[str, Edit]] = {
    "fine": {
        "as it is": lambda image: image,
        "noise": partial(noisy, sigma=2.0),
        "JPEG": partial(jpeg, quality=80),
        "gain × 1.01": partial(light, gain=1.01),
    },
    "out of focus": {f"σ {s:g} px": partial(blur, sigma_px=s) for s in (3, 6, 2.7, 5.2, 7.5)}
    | {f"σ {s:g} px, with noise": partial(blur, sigma_px=s, noise=0.6) for s in (4, 7)},
    "gain changed": {f"× {k:g}": partial(light, gain=k) for k in (0.9, 1.08, 0.87, 0.95, 1.06, 1.14)},
    "gamma changed": {f"{k:g}": partial(light, gamma=k) for k in (0.8, 1.25, 0.7, 0.85, 1.18, 1.35)},
    "camera moved": {f"{m}": partial(move, x=m[0], y=m[1], clockwise_deg=m[2]) for m in ((2, -1, 0), (0, 0, 2))}
    | {
        f"{m}": partial(move, x=m[0], y=m[1], clockwise_deg=m[2])
        for m in ((1.8, 2.2, 0), (-7, 9, 1.3), (12, -11, -0.5))
    },
    "image mirrored": {
        way: partial(flip, code=code) for way, code in (("left–right", 1), ("up–down", 0), ("180°", -1))
    },
    "dirt or damage": {
        "speck": partial(spot, change=-0.4, radius_px=8),
        "stain": partial(spot, change=-0.12, radius_px=18, x=420, y=330),
        "crumb": partial(spot, change=-0.35, radius_px=6, x=400, y=170),
        "reflection": partial(spot, change=0.12, radius_px=12, x=210, y=300),
    },
    "light uneven": {
        "LED left": partial(failed_led, part=0.2),
        "LED above": partial(failed_led, part=0.3, at=(320, 0)),
        "LED in a corner": partial(failed_led, part=0.25, at=(640, 480)),
    },
    "light colour changed": {
        "warm": partial(light, gain=(0.94, 1.0, 1.05)),
        "blue": partial(light, gain=(1.12, 1.0, 1.0)),
        "green": partial(light, gain=(1.0, 1.09, 1.0)),
    },
    "dim": {f"× {k:g}": partial(light, gain=k) for k in (0.55, 0.4, 0.48, 0.33)},
    "compressed": {f"JPEG {quality}": partial(jpeg, quality=quality) for quality in (40, 20)},
}
UNSEEN = {
    "out of focus": {"σ 2.7 px", "σ 5.2 px", "σ 7.5 px"},
    "gain changed": {"× 0.87", "× 0.95", "× 1.06", "× 1.14"},
    "gamma changed": {"0.7", "0.85", "1.18", "1.35"},
    "camera moved": {"(1.8, 2.2, 0)", "(-7, 9, 1.3)", "(12, -11, -0.5)"},
    "dirt or damage": {"crumb", "reflection"},
    "light uneven": {"LED in a corner", "LED above"},
    "light colour changed": {"green"},
    "dim": {"× 0.48", "× 0.33"},
}
"""Strengths that were drawn after all limits had been chosen."""
OF_SETS: dict[str, tuple[tuple[str, ...], ...]] = {
    "fine": (PAIRS[0] + PAIRS[1],),
    "out of focus": (PAIRS[0] + PAIRS[1], PAIRS[1], ("ball",), ("board_reference",)),
    "gain changed": (PAIRS[1], ("ball",)),
    "gamma changed": (PAIRS[1],),
    "camera moved": (PAIRS[1], ("ball",)),
    "image mirrored": (PAIRS[1], ("board",), ("ball",)),
    "dirt or damage": (PAIRS[1], ("ball",)),
    "light uneven": (PAIRS[1],),
    "light colour changed": (PAIRS[1],),
    "dim": (PAIRS[0] + PAIRS[1],),
    "compressed": (PAIRS[0] + PAIRS[1],),
}
"""The images of a calibration that have the fault. A failed LED or a gamma between an image and the next is not tried."""


@dataclass(frozen=True)
class Trial:
    command: str
    cause: str
    named: str
    is_unseen: bool
    kind: str
    """Real sensor or twin."""

    @property
    def outcome(self) -> str:
        return "right" if self.named == self.cause else "unknown" if self.named == "unknown" else "wrong"


def diagnosis(quick: bool = False, json: bool = False) -> None:
    """Edit images and count the causes that are named."""
    cv2.setNumThreads(1)
    sensors = dict(sensor_images(quick))
    trials = [*check_trials(sensors, quick), *set_trials(sensors, quick)]
    answer("Most probable cause", list(figures_of(trials)), json)


def sensor_images(quick: bool) -> Iterator[tuple[str, dict[str, Image]]]:
    """Yield name and images of every sensor, real ones first."""
    for folder in sensor_folders():
        yield (
            folder.name,
            {name: image for name, image in vars(calibration_images(folder.name)).items() if image is not None},
        )
    if quick:
        return
    for name, who in twins_of_real_fits().items():
        if name in "AL":
            yield f"twin {name}", vars(simulate_calibration_images(who.twin(), who.design, presses=who.presses))
    for number in (20,):
        who = sample_sensor(number, 77)
        presses = replace(who.presses, exposure_drift=0.0)
        yield f"twin {who.name}", vars(simulate_calibration_images(who.twin(), who.design, presses=presses, frames=4))


def check_trials(sensors: dict[str, dict[str, Image]], quick: bool) -> Iterator[Trial]:
    """Yield what check names for edited reference images, and for those of others and of presses."""
    of_lens = calibrated("sensor_a", "physics")
    rectify, curve = of_lens.rectify, of_lens.ball.curve
    for number, (name, images) in enumerate(sensors.items()):
        if quick and number:
            return
        known = CalibratedReference(images["board_reference"], images["ball_reference"], rectify, curve)
        for cause, edits in list(EDITS.items())[: 3 if quick else None]:
            for count, (strength, edit) in enumerate(edits.items()):
                if not quick or count == 0:
                    yield checked(name, known, cause, strength, edit(images[REFERENCES[count % 2]]))
        for other, its in sensors.items():
            if other != name and ("twin" in other) == ("twin" in name):
                yield checked(name, known, "another sensor's gel", other, its["board_reference"])
        if name != "sensor_j":  # its ball image shows no contact
            yield checked(name, known, "something touches the gel", "ball", images["ball"])


def checked(name: str, known: CalibratedReference, cause: str, strength: str, image: Image) -> Trial:
    drift = measure_drift(known, image)
    found = diagnose_drift(drift)
    named = found[0].diagnosis if found else "fine"
    cannot_tell = (cause == "out of focus" and drift.sharpness is None) or (
        cause in ("camera moved", "image mirrored") and not drift.moved.observable
    )
    return reported("check", name, cause, strength, "unknown" if named == "fine" and cannot_tell else named)


def set_trials(sensors: dict[str, dict[str, Image]], quick: bool) -> Iterator[Trial]:
    """Yield what the images of a calibration tell where some of them have a fault."""
    for number, (name, images) in enumerate(sensors.items()):
        if quick and number:
            return
        for cause, faulty in list(OF_SETS.items())[: 2 if quick else None]:
            for count, (strength, edit) in enumerate(EDITS[cause].items()):
                for names in faulty:
                    if quick and count:
                        continue
                    edited = {key: edit(image) if key in names else image for key, image in images.items()}
                    yield judged(name, cause, strength, edited)
        others = [its for other, its in sensors.items() if other != name and ("twin" in other) == ("twin" in name)]
        for its in others[:2]:
            yield judged(name, "another sensor's gel", "ball", images | {key: its[key] for key in PAIRS[1]})


def judged(name: str, cause: str, strength: str, images: dict[str, Image]) -> Trial:
    board, ball = ((images[before], images[under]) for before, under in PAIRS)
    found = find_image_cause(board, ball)
    named = found.cause if found is not None else "fine" if cause == "fine" else "unknown"
    return reported("calibrate", name, cause, strength, named)


def reported(command: str, name: str, cause: str, strength: str, named: str) -> Trial:
    one = Trial(command, cause, named, strength in UNSEEN.get(cause, ()), "twin" if "twin" in name else "real")
    if one.outcome != "right":
        print(f"{command}: {name}: {cause}, {strength}: {named}", flush=True)
    return one


def figures_of(trials: list[Trial]) -> Iterator[Figure]:
    """One line for each cause, and the shares that must be right."""
    for command in dict.fromkeys(one.command for one in trials):
        some = [one for one in trials if one.command == command]
        for cause in dict.fromkeys(one.cause for one in some):
            of_cause = [one for one in some if one.cause == cause]
            count = Counter(one.outcome for one in of_cause)
            confused = Counter(one.named for one in of_cause if one.outcome == "wrong")
            words = f"{count['right']} right, {count['unknown']} unknown, {count['wrong']} wrong"
            names = ", ".join(f"{name} {number}" for name, number in confused.items())
            yield Figure(f"{command}: {cause}", words + (f" ({names})" if names else ""))
        for what, part in (
            ("", some),
            (", real sensors", [one for one in some if one.kind == "real"]),
            (", strengths drawn after the limits", [one for one in some if one.is_unseen]),
        ):
            told = [one for one in part if one.outcome != "unknown"]
            if told:
                share = sum(one.outcome == "right" for one in told) / len(told)
                yield at_least(f"{command}{what}: right of {len(told)} named", share, RIGHT_SHARE)
                yield Figure(f"{command}{what}: unknown", f"{len(part) - len(told)} of {len(part)}")


if __name__ == "__main__":
    tyro.cli(diagnosis)

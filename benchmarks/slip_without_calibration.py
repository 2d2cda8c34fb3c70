"""Slip from rectified images of sensors without a calibration: the motions of `simulation.object_motions`, which also says what the
true slip is, on twins that differ from the published sensor in gel, light, view and friction, in small compressed images, every
fourth sequence as a video, judged by the macro F1 of static, incipient and gross slip; and what is lost where the images of the
first of them are changed as people's images differ.

Images without contact are not judged. Constants were chosen on one half of objects, sizes and sensors; figures are of the other.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least

from ninedtact.capture.frame_source import FrameSource, source_ended
from ninedtact.capture.video_file import VideoFile
from ninedtact.design import Gel, rectified_mm_per_px
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.rectified_images import open_rectified
from ninedtact.reference_frames import read_reference_frames
from ninedtact.simulation.gel_brightness import FITTED_PARAMETERS, BrightnessModel, synthetic_reference_image
from ninedtact.simulation.object_motions import HZ, MOTION_KINDS, MotionSettings, play_motion
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.pixel_to_skin_map import PixelToSkinMap
from ninedtact.simulation.renderer import CameraNoise, Renderer
from ninedtact.simulation.twin import Twin
from ninedtact.tracking import SequenceTracker

DEVELOP, REPORT = 0, 1
"""The halves: constants were chosen on sequences of the first; figures are of the second."""
OBJECTS = (
    ("ball:4", "ball:6", "cylinder:3,11", "cross_03", "key_05", "gear_07"),
    ("ball:3", "ball:8", "ellipsoid:6,3,3", "spanner_02", "letter_17", "punch:3,1"),
)
SIZES = ((80, 60), (160, 120), (240, 180)), ((60, 44), (108, 80), (320, 240))
RENDERED_COLS = 320
PITCH_MM = 0.4
STRIDES = 6, 4, 2, 1
"""Images of a motion from one to the next in a sequence, which has 10 to 60 images per second."""
CHANGED_SEQUENCES = 12
"""The first sequences, of which changed images are judged too: every object, dragged, and dragged back."""
UNTOUCHED_S, UNTOUCHED_IMAGES = (0.3, 0.6), 6
"""Time without contact at the beginning, and images in it at least."""


def slip_without_calibration(sequences: int = 60, half: int = REPORT, quick: bool = False, json: bool = False) -> None:
    """Simulate presses with drags and judge the slip that is found in their images alone."""
    drags = [simulate_drag(number, half) for number in range(2 if quick else sequences)]
    judged = [judge(drag) for drag in drags]
    changed = {"unchanged": macro_f1_of(judged[:CHANGED_SEQUENCES])}
    for name, change in CHANGES.items():
        changed[name] = macro_f1_of([judge(change(drag)) for drag in drags[:CHANGED_SEQUENCES]])
    figures = [
        *slip_figures(judged),
        Figure("macro F1 of changed images: mean", float(np.mean(list(changed.values())))),
        *(Figure(f"macro F1, {name}", score) for name, score in changed.items()),
        *displacement_figures(judged),
        Figure("time of one image, ms", float(np.mean([one.ms for one in judged]))),
    ]
    answer("Slip without a calibration", figures, json)


def slip_figures(judged: list["Judged"]) -> Iterator[Figure]:
    """Yield the scores of all images, by object and by kind of motion, and that of a constant answer."""
    truth, found = (np.concatenate([getattr(one, part) for one in judged]) for part in PARTS)
    scores, by_object = class_f1(truth, found), macro_f1_by("item", judged)
    yield at_least("macro F1 of all images", float(scores.mean()), 0.6)
    yield Figure("F1 of static, incipient and gross", ", ".join(f"{score:.2f}" for score in scores))
    yield Figure("macro F1 by object: mean", float(np.mean(list(by_object.values()))))
    yield at_least("macro F1 by object: worst", min(by_object.values()), 0.4)
    yield from (Figure(f"macro F1 of {name}", score) for name, score in macro_f1_by("kind", judged).items())
    yield Figure("macro F1 of always answering gross", macro_f1(truth, np.full_like(truth, "gross")))
    yield Figure("images judged: static, incipient, gross", ", ".join(f"{(truth == slip).sum()}" for slip in CLASSES))


def displacement_figures(judged: list["Judged"]) -> Iterator[Figure]:
    """Yield the errors of displacement, and whether the stated ones contain them."""
    error_mm, deviation = [one.error_mm for one in judged], np.concatenate([one.deviation for one in judged])
    within = f"{(deviation < 2).mean():.2f}, {(deviation < 3).mean():.2f}"
    yield Figure("displacement, error, median over sequences, mm", float(np.median(error_mm)))
    yield Figure("displacement, error, largest tenth of sequences, mm", float(np.quantile(error_mm, 0.9)))
    yield Figure("displacement within two and three standard deviations", within)


CLASSES, PARTS = ("static", "incipient", "gross"), ("truth", "found")


@dataclass(frozen=True)
class Judged:
    """One sequence as it was found."""

    item: str
    kind: str
    truth: np.ndarray
    found: np.ndarray
    error_mm: float
    """Root mean square error of displacement under at least a third of the greatest load, but for its mean."""
    deviation: np.ndarray
    """Error of displacement along x or y, the greater, since the first of these images, over its stated standard deviation."""
    ms: float


def judge(drag: "Drag") -> Judged:
    """Return what is found in the images of a sequence, and how far it is from the truth."""
    began = process_time()
    source = ImageSequence(drag.images, drag.rate_hz)
    with open_rectified(source, read_reference_frames(source)) as sensor:
        tracker = SequenceTracker()
        for reading in sensor:
            tracker.add(reading)
        images = tracker.finish()
    ms = 1e3 * (process_time() - began) / len(images)
    labels = np.array(drag.labels)
    moved_mm, std_mm = (np.array([getattr(image.motion, part) for image in images]) for part in ("moved_mm", "std_mm"))
    scale = drag.mm_per_px / rectified_mm_per_px(drag.images.shape[:0:-1])
    firm = np.isfinite(moved_mm[:, 0]) & (-drag.forces_n[:, 2] > -drag.forces_n[:, 2].min() / 3)
    error_mm = (moved_mm[firm] * scale - drag.poses[firm, :2]) if firm.any() else np.zeros((1, 2))
    since = np.abs(error_mm - error_mm[0])[1:] / np.maximum(np.hypot(std_mm[firm][1:], std_mm[firm][:1]), 1e-9)
    error_mm = error_mm - error_mm.mean(axis=0)
    return Judged(
        drag.item,
        drag.kind,
        labels[labels != ""],
        np.array([image.slip_label for image in images])[labels != ""],
        float(np.sqrt((error_mm**2).sum(axis=1).mean())),
        since.max(axis=1),
        ms,
    )


def macro_f1_by(part: str, judged: list[Judged]) -> dict[str, float]:
    """Return the macro F1 of the sequences of each object ("item") or kind of motion ("kind")."""
    names = dict.fromkeys(getattr(one, part) for one in judged)
    return {name: macro_f1_of([one for one in judged if getattr(one, part) == name]) for name in names}


def macro_f1_of(judged: list[Judged]) -> float:
    """Return the macro F1 of all images of several sequences."""
    return macro_f1(*(np.concatenate([getattr(one, part) for one in judged]) for part in PARTS))


def class_f1(truth: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Return the F1 of each class; one for a class that is neither there nor found."""
    return np.array(
        [
            2 * ((truth == slip) & (found == slip)).sum() / max((truth == slip).sum() + (found == slip).sum(), 1)
            if (truth == slip).any() or (found == slip).any()
            else 1.0
            for slip in CLASSES
        ]
    )


def macro_f1(truth: np.ndarray, found: np.ndarray) -> float:
    """Return the mean F1 of the classes."""
    return float(class_f1(truth, found).mean())


class ImageSequence(FrameSource):
    """A frame source of images in memory."""

    is_live, name = False, "simulated images"

    def __init__(self, images: np.ndarray, rate_hz: float) -> None:
        self._images, self._rate_hz, self._next = images, rate_hz, 0

    def open(self) -> None:
        """Start with the first image."""
        self._next = 0

    def read(self) -> Frame:
        """Return the next image; raises `SourceEnded`."""
        if self._next == len(self._images):
            raise source_ended(self.name, self._next)
        self._next += 1
        image = cv2.cvtColor(self._images[self._next - 1], cv2.COLOR_GRAY2BGR)
        return Frame(image, round(1e9 * (self._next - 1) / self._rate_hz), self._next - 1)

    def close(self) -> None:
        """Nothing to close."""


@dataclass(frozen=True)
class Drag:
    """Images of one press with a drag, and the truth of each."""

    name: str
    images: np.ndarray
    """(n, rows, cols), grey, uint8."""
    rate_hz: float
    poses: np.ndarray
    """x, y and depth of the object in mm, (n, 3)."""
    forces_n: np.ndarray
    """(n, 3)."""
    labels: list[str]
    """The true slip of each image; empty where it is not judged."""
    mm_per_px: float
    item: str
    kind: str


def simulate_drag(number: int, half: int) -> Drag:
    """Return one sequence of a half, which its number determines."""
    rng = np.random.default_rng([number, half])
    size = SIZES[half][number % len(SIZES[half])]
    item = OBJECTS[half][number % len(OBJECTS[half])]
    kind, stride = MOTION_KINDS[number // len(OBJECTS[half]) % len(MOTION_KINDS)], int(rng.choice(STRIDES))
    twin, rate_hz, speed_mm_s = twin_of(rng), HZ / stride, float(np.exp(rng.uniform(np.log(1.5), np.log(30))))
    (x, y), (twist, direction) = rng.uniform(-1.5, 1.5, 2).tolist(), rng.uniform(0, 2 * np.pi, 2).tolist()
    settings = MotionSettings(Pose(x, y, rng.uniform(0.25, 0.75), twist), speed_mm_s, twin.friction, direction)
    steps = list(play_motion(twin, indenter_from_name(item), settings.motion(kind)))[::stride]
    untouched = max(round(rng.uniform(*UNTOUCHED_S) * rate_hz), UNTOUCHED_IMAGES)
    noise, quality, drift = rng.uniform(0.4, 1.5), int(rng.integers(75, 99)), rng.normal(0, 0.004)
    images, count = list[np.ndarray](), untouched + len(steps)
    for index, step in enumerate([None] * untouched + steps):
        touches = step is not None and step.press.touches
        image = twin.renderer.render_without_noise(step.press.corrected) if touches else twin.renderer.reference
        small = cv2.resize(image, size, interpolation=cv2.INTER_AREA) * (1 + drift * index / count)
        noisy = np.clip(small + rng.normal(0, noise, small.shape[:2])[..., None], 0, 255).astype(np.uint8)
        images.append(noisy)
    poses = [(step.press.pose.x_mm, step.press.pose.y_mm, step.press.pose.depth_mm) for step in steps]
    return Drag(
        f"{item} {kind} {size[0]}x{size[1]} {rate_hz:.0f} Hz {speed_mm_s:.1f} mm/s μ {twin.friction:.2f}",
        store_as_video(images, rate_hz)
        if number % 4 == 3
        else np.array([store_as_jpeg(one, quality) for one in images]),
        rate_hz,
        np.array([poses[0]] * untouched + poses, float),
        np.concatenate([np.zeros((untouched, 3)), [step.press.wrench.force_n for step in steps]]),
        [""] * untouched + ["" if step.slip.state == "unknown" else step.slip.state for step in steps],
        2 * twin.renderer.pixel_map.reach_mm[0] / size[0],
        item,
        kind,
    )


def store_as_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    """Return an image as a JPEG file gives it back in grey."""
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE))


def store_as_video(images: list[np.ndarray], rate_hz: float) -> np.ndarray:
    """Return BGR images in grey as an MPEG-4 video gives them back, which compresses far more."""
    with TemporaryDirectory() as folder:
        path = str(Path(folder) / "drag.mp4")
        rows, cols = images[0].shape[:2]
        video = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"mp4v"), rate_hz, (cols, rows))
        for image in images:
            video.write(image)
        video.release()
        with VideoFile(path) as source:
            return np.array([cv2.cvtColor(frame.image, cv2.COLOR_BGR2GRAY) for frame in source])


def change_light(drag: Drag, factor: np.ndarray | float) -> Drag:
    """Return a sequence whose images are multiplied, (n, rows, cols) or what is broadcast to it."""
    return replace(drag, images=np.clip(np.rint(drag.images * factor), 0, 255).astype(np.uint8))


def flicker(drag: Drag) -> Drag:
    """Return a sequence whose light changes by 1 % from image to image."""
    return change_light(drag, 1 + np.random.default_rng(0).normal(0, 0.01, (len(drag.images), 1, 1)))


def tilt_light(drag: Drag) -> Drag:
    """Return a sequence in which the light falls by 3 % on one side and rises on the other until the end."""
    across = np.linspace(-0.03, 0.03, drag.images.shape[2])
    return change_light(drag, 1 + np.linspace(0, 1, len(drag.images))[:, None, None] * across)


def subtract_background(drag: Drag) -> Drag:
    """Return a sequence of differences to its first image, about mid-grey."""
    return replace(drag, images=np.clip(drag.images.astype(int) - drag.images[0] + 128, 0, 255).astype(np.uint8))


def choose_images(drag: Drag, numbers: np.ndarray) -> Drag:
    """Return the sequence of these images, which is taken to have the same rate."""
    arrays = {name: getattr(drag, name)[numbers] for name in ("images", "poses", "forces_n")}
    return replace(drag, **arrays, labels=[drag.labels[number] for number in numbers])


def drop_images(drag: Drag) -> Drag:
    """Return a sequence that lacks a quarter of its images, without saying so."""
    keep = np.random.default_rng(0).random(len(drag.images)) > 0.25
    keep[:UNTOUCHED_IMAGES] = True
    return choose_images(drag, np.flatnonzero(keep))


def begin_in_contact(drag: Drag) -> Drag:
    """Return a sequence that begins under the load from which it is dragged, and ends without contact."""
    untouched = drag.labels.count("")
    pressed = np.arange(untouched + 20 * int(drag.rate_hz) // int(HZ), len(drag.images))
    return choose_images(drag, np.concatenate([pressed, np.arange(UNTOUCHED_IMAGES)]))


CHANGES: dict[str, Callable[[Drag], Drag]] = {
    "JPEG quality 40": lambda drag: replace(drag, images=np.array([store_as_jpeg(one, 40) for one in drag.images])),
    "light changes by 1 % from image to image": flicker,
    "light tilts by 3 %": tilt_light,
    "0.4 of the light": lambda drag: change_light(drag, 0.4),
    "1.35 of the light": lambda drag: change_light(drag, 1.35),
    "black borders": lambda drag: replace(drag, images=np.pad(drag.images, ((0, 0), (12, 12), (0, 0)))),
    "background subtracted": subtract_background,
    "each image twice": lambda drag: choose_images(drag, np.repeat(np.arange(len(drag.images)), 2)),
    "a quarter of the images missing": drop_images,
    "begins in contact": begin_in_contact,
}
"""Ways in which sequences differ from those above."""


def twin_of(rng: np.random.Generator) -> Twin:
    """Return a sensor that differs from the published one in everything that its images do not tell."""
    light = {name: spread.sample(rng) for name, spread in FITTED_PARAMETERS.items()}
    thickness_mm = 2.5 * light.pop("relative_thickness") * rng.uniform(0.8, 1.3)
    gel = Gel(thickness_mm, rng.uniform(0.03, 0.2), gel_to_base_modulus_ratio=float(rng.choice([0.0, 0.02, 0.04, 0.1])))
    model = replace(BrightnessModel(), **light, thickness_mm=thickness_mm)
    view_mm = rng.uniform(20, 28)
    cols, rows = RENDERED_COLS, RENDERED_COLS * 3 // 4
    x, y = np.meshgrid(*((np.arange(side) - (side - 1) / 2) * view_mm / cols for side in (cols, rows)))
    pixel_map = PixelToSkinMap(np.stack([x, y], axis=-1).astype(np.float32))
    cast = tuple(rng.uniform(0.8, 1.2, 3).tolist())
    reference = synthetic_reference_image(
        pixel_map, rng.uniform(110, 180), rng.uniform(0.01, 0.04), cast, int(rng.integers(1000)), rng.uniform(0, 0.3)
    )
    renderer = Renderer(pixel_map, reference, model, CameraNoise(shape=(rows, cols)))
    friction = float(np.exp(rng.uniform(np.log(0.2), np.log(1.2))))
    return Twin("uncalibrated", gel, renderer, friction, PITCH_MM)


if __name__ == "__main__":
    tyro.cli(slip_without_calibration)

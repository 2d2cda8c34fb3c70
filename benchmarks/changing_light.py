"""Light that changes: contacts called where nothing touches, light contacts found, and presses under another gain or gamma.

Streams are those of twins of real sensors, with the reference image and noise of a real one, at one image a second of simulated
time. The light changes before the noise and the 8 bits of the camera. After the time without contact, contacts of 0.1 N are shown
for five images each, and found or not in the last. Presses are the real balls, and presses of twins, changed after 8 bits; errors
are those beside the same press unchanged. Sensor A was used to choose the limits, the others were not. H.264 needs PyAV
(`pip install av`); without it that line is left out.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import numpy as np
import tyro
from figures import Figure, answer, at_least, at_most
from real_images import calibrated, calibration_images
from real_sensor_twins import twins_of_real_fits

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.capture.frame_source import FrameSource
from ninedtact.force.contact_detection import measure_darkening_on_cells
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.reference_images import FollowingSettings, ReferenceImages
from ninedtact.sensor import Sensor
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.objects.catalogue import indenter_from_name

RATE_HZ = 1.0
BALLS = "ball:2", "ball:4", "ball:8"
LIGHT_LOAD_N = 0.1
HELD_IMAGES, REST_IMAGES = 5, 3
Image = np.ndarray
Change = Callable[[Image, float], Image]


def bands(image: Image, at_s: float, amplitude: float, period_px: float = 170.0) -> Image:
    """Bands that move over the rows by a part of their period from image to image."""
    phase = np.arange(image.shape[0]) / period_px + 2.37 * at_s
    return image * (1 + amplitude * np.sin(2 * np.pi * phase)).astype(np.float32)[:, None, None]


def flicker(image: Image, at_s: float, amplitude: float) -> Image:
    return image * np.float32(1 + amplitude * np.sin(2 * np.pi * 0.73 * at_s))


def drift(image: Image, at_s: float) -> Image:
    """Up by 1 % a minute for ten minutes, and down again."""
    minutes = at_s / 60 % 20
    return image * np.float32(1.01 ** min(minutes, 20 - minutes))


def speck(image: Image, at_s: float, centre_px: tuple[int, int] = (400, 200)) -> Image:
    """A spot of radius 8 px, 40 % darker, that arrives after the reference."""
    if at_s < 5:
        return image
    rows, cols = np.mgrid[: image.shape[0], : image.shape[1]]
    spot = np.hypot(cols - centre_px[0], rows - centre_px[1]) < 8
    return image * np.where(spot, 0.6, 1.0).astype(np.float32)[..., None]


def hair(image: Image) -> Image:
    """A line of two pixels over the middle."""
    line = np.zeros(image.shape[:2], np.uint8)
    cv2.line(line, (180, 150), (460, 330), (1,), 2)
    return image * np.where(line > 0, 0.5, 1.0).astype(np.float32)[..., None]


def gradient(image: Image, amplitude: float) -> Image:
    """One side brighter and the other dimmer."""
    across = np.linspace(-1, 1, image.shape[1], dtype=np.float32)
    return image * np.exp(np.float32(amplitude) * across)[:, None]


def second_order(image: Image, amplitude: float, saddle: bool = False) -> Image:
    """The middle brighter than the border, or two corners brighter than the others."""
    across, along = (np.linspace(-1, 1, side, dtype=np.float32) for side in image.shape[1::-1])
    shape = np.outer(along, across) if saddle else 0.5 - np.add.outer(along**2, across**2) / 2
    return image * np.exp(np.float32(amplitude) * (shape if saddle else 2 * shape))[..., None]


def gamma(image: Image, exponent: float) -> Image:
    return np.asarray(255 * (image / np.float32(255)) ** exponent)


STREAMS: dict[str, Change] = {
    "steady": lambda image, _: image,
    "flicker ±0.5 %": partial(flicker, amplitude=0.005),
    "flicker ±2 %": partial(flicker, amplitude=0.02),
    "bands ±0.5 %": partial(bands, amplitude=0.005),
    "bands ±4 %": partial(bands, amplitude=0.04),
    "bands ±2 %, 1.2 cycles over the image": partial(bands, amplitude=0.02, period_px=400),
    "MJPEG quality 40": lambda image, _: image,
    "H.264 crf 28": lambda image, _: image,
    "drift 1 % a minute": drift,
    "speck": speck,
    "steps of a digital gain": lambda image, _: image,
}
DIGITAL_GAINS = 1.0, 1.08, 0.985, 0.95
"""Each for a minute, applied by the camera to whole grey levels."""
PRESSES: dict[str, Callable[[Image], Image]] = {
    "gain × 1.02": lambda image: image * np.float32(1.02),
    "gain × 1.05": lambda image: image * np.float32(1.05),
    "gain × 0.95": lambda image: image * np.float32(0.95),
    "gamma 0.9": partial(gamma, exponent=0.9),
    "gradient ±2 %": partial(gradient, amplitude=0.02),
    "brighter middle ±2 %": partial(second_order, amplitude=0.02),
    "brighter border ±2 %": partial(second_order, amplitude=-0.02),
    "brighter corners ±2 %": partial(second_order, amplitude=0.02, saddle=True),
    "bands ±0.5 %": partial(bands, at_s=0.1, amplitude=0.005),
    "bands ±4 %": partial(bands, at_s=0.1, amplitude=0.04),
    "speck": partial(speck, at_s=9),
    "hair over the press": hair,
}


class H264:
    """Encodes and decodes one stream, image by image."""

    def __init__(self) -> None:
        import av

        self._av = av
        self._encoder = av.CodecContext.create("libx264", "w")
        self._encoder.width, self._encoder.height, self._encoder.pix_fmt = 640, 480, "yuv420p"
        self._encoder.options = {"crf": "28", "preset": "veryfast", "tune": "zerolatency"}
        from fractions import Fraction

        self._encoder.time_base = Fraction(1, 30)
        self._decoder = av.CodecContext.create("h264", "r")
        self._decoder.thread_count = 1

    def __call__(self, image: Image) -> Image:
        frame = self._av.VideoFrame.from_ndarray(image, format="bgr24")
        decoded = [out for packet in self._encoder.encode(frame) for out in self._decoder.decode(packet)]
        return np.asarray(decoded[-1].to_ndarray(format="bgr24"))


class DigitalGain:
    """Applies another gain every minute, image by image."""

    def __init__(self) -> None:
        self._number = 0

    def __call__(self, image: Image) -> Image:
        gain = DIGITAL_GAINS[int(self._number / RATE_HZ / 60) % len(DIGITAL_GAINS)]
        self._number += 1
        return np.clip(np.rint(image * np.float32(gain)), 0, 255).astype(np.uint8)


def jpeg(image: Image) -> Image:
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, 40])[1], cv2.IMREAD_COLOR))


@dataclass
class ChangingLight(FrameSource):
    """A twin's images in changing light, at simulated times; what presses is set from outside."""

    folder: SensorFolder
    change: Change
    codec: Callable[[Image], Image]
    pressed: Image | None = None
    name: str = "changing light"
    is_live: bool = True
    is_simulated: bool = True
    _number: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._renderer = self.folder.twin().renderer

    @property
    def untouched(self) -> Image:
        """The image without contact, noise and change of light."""
        return self._renderer.reference

    def open(self) -> None: ...

    def close(self) -> None: ...

    def read(self) -> Frame:
        at_s, clean = self._number / RATE_HZ, self._renderer.reference if self.pressed is None else self.pressed
        image = self.codec(self._renderer.noise.add_to(np.asarray(self.change(clean, at_s), np.float32), self._number))
        self._number += 1
        return Frame(image, round(at_s * 1e9) + 1, self._number - 1)


def changing_light(
    hours: float = 1.0,
    presses: int = 40,
    sensors: tuple[str, ...] = ("sensor_a", "sensor_i", "twin P", "twin R"),
    streams: tuple[str, ...] = (),
    load_n: float = LIGHT_LOAD_N,
    quick: bool = False,
    json: bool = False,
) -> None:
    """Print false contacts, light contacts found, and the errors of presses.

    hours: of each stream on each sensor. streams: words of those that are shown; of all where there are none. load_n: of the light
    contacts.
    """
    cv2.setNumThreads(1)
    hours, presses = (12 / 3600, 2) if quick else (hours, presses)
    kinds = [kind for kind in STREAMS if not streams or any(words in kind for words in streams)][: 3 if quick else None]
    with TemporaryDirectory() as out:
        folders = dict(make_sensors(Path(out), sensors[: 1 if quick else None]))
        figures = [
            one for name, folder in folders.items() for one in of_streams(name, folder, hours, presses, load_n, kinds)
        ]
        if not streams:
            figures += [*of_presses(folders, quick), *of_references(folders)]
    answer("Light that changes", figures, json)


def make_sensors(out: Path, names: tuple[str, ...]) -> Iterator[tuple[str, SensorFolder]]:
    """Calibrate real sensors, and twins of others."""
    for name in names:
        if name.startswith("sensor"):
            save_sensor(out / name, calibrated(name, "physics"))
            yield name, load_sensor(out / name)
            continue
        who = twins_of_real_fits()[name.removeprefix("twin ")]
        images = CalibrationImages(
            **vars(simulate_calibration_images(who.twin(), who.design, presses=who.presses, frames=4))
        )
        save_sensor(out / name, calibrate(images, who.design, sensor_id=name))
        yield name, load_sensor(out / name)


def of_streams(
    name: str, folder: SensorFolder, hours: float, presses: int, load_n: float, kinds: list[str]
) -> Iterator[Figure]:
    """Yield false contacts and light contacts found of every stream."""
    contacts = list(press_images(folder, load_n, presses))
    for kind in kinds:
        change = STREAMS[kind]
        codec: Callable[[Image], Image] = jpeg if "JPEG" in kind else np.asarray
        if "digital" in kind:
            codec = DigitalGain()
        if "H.264" in kind:
            try:
                codec = H264()
            except ImportError:
                continue
        source = ChangingLight(folder, change, codec)
        references = ReferenceImages(following=FollowingSettings())
        with Sensor(source, folder.shape, references, folder.estimator("physics")) as sensor:
            count = round(hours * 3600 * RATE_HZ)
            false, warned = 0, dict[str, int]()
            for _ in range(count):
                reading = sensor.read()
                false += is_touched(reading)
                for warning in reading.warnings:
                    warned[warning] = warned.get(warning, 0) + 1
            found, shown = 0, list[float]()
            for image in contacts:
                source.pressed = image
                held = [sensor.read() for _ in range(HELD_IMAGES)]
                found += is_touched(held[-1])
                shown.append(share_shown(held[-1], image, source.untouched, folder))
                source.pressed = None
                for _ in range(REST_IMAGES):
                    sensor.read()
        said = ", ".join(f"{words} {number / max(count, 1):.0%}" for words, number in warned.items()) or "no warnings"
        yield at_most(f"{name}, {kind}: false contacts in {count} images, {hours:.2g} h", false, 0, peer=said)
        half, tenth = np.quantile(shown, (0.5, 0.1)) if shown else (np.nan, np.nan)
        yield Figure(
            f"{name}, {kind}: share of their darkening in the image, median / tenth", f"{half:.0%} / {tenth:.0%}"
        )
        yield at_least(f"{name}, {kind}: contacts of {load_n:g} N found of {presses}", found / presses, 0.95)


def share_shown(reading: Reading, pressed: Image, untouched: Image, folder: SensorFolder) -> float:
    """Return the darkening of a contact where it is darkest, over that without noise and compression."""
    without = read_frame(
        Frame(np.rint(pressed).astype(np.uint8)),
        folder.shape,
        folder.shape.depth_reader(Frame(np.rint(untouched).astype(np.uint8))),
    )
    true = measure_darkening_on_cells(without)
    return float(measure_darkening_on_cells(reading).flat[true.argmax()] / true.max())


def is_touched(reading: Reading) -> bool:
    return reading.force is not None and reading.force.touching


def press_images(folder: SensorFolder, load_n: float, count: int) -> Iterator[Image]:
    """Yield images without noise of balls with a load, at random places."""
    twin, rng = folder.twin(), np.random.default_rng(33)
    for number in range(count):
        x_mm, y_mm = float(rng.uniform(-7, 7)), float(rng.uniform(-5, 5))
        press = twin.press(None, indenter_from_name(BALLS[number % 3]), Pose(x_mm, y_mm, 0.05), load_n=load_n)
        yield twin.renderer.render_without_noise(press.corrected)


def of_presses(sensors: dict[str, SensorFolder], quick: bool) -> Iterator[Figure]:
    """Yield, for every change, depth and force relative to the press unchanged: mean and worst, and which were warned of."""
    cases = [case for name, folder in sensors.items() for case in press_cases(name, folder, 1 if quick else 3)]
    for kind, change in list(PRESSES.items())[: 2 if quick else None]:
        rows = [compare_press(*case, change) for case in cases]
        errors = np.abs(np.array([row[:2] for row in rows]) - 1)
        silent = [float(max(error)) for error, row in zip(errors, rows, strict=True) if not row[2]]
        parts = zip(("depth", "force"), errors.T, strict=True)
        text = ", ".join(f"{part} {error.mean():.1%} / {error.max():.1%}" for part, error in parts)
        yield Figure(
            f"{kind}: errors of {len(rows)} presses, mean / worst", f"{text}; {len(rows) - len(silent)} warned"
        )
        yield at_most(f"{kind}: worst error without a warning, %", 100 * max(silent, default=0.0), 5.0, "%")


def press_cases(name: str, folder: SensorFolder, count: int) -> Iterator[tuple[SensorFolder, Image, Image]]:
    """Yield sensor, reference image and pressed image, of the real ball and of twins."""
    if name.startswith("sensor"):
        images = calibration_images(name)
        yield folder, np.asarray(images.ball_reference), np.asarray(images.ball)
    noise, reference = folder.twin().renderer.noise, folder.twin().renderer.reference
    for load_n in (1.0, 3.0, 6.0)[:count]:
        for number, image in enumerate(press_images(folder, load_n, count)):
            yield folder, noise.add_to(reference, number), noise.add_to(image, number + 50)


def of_references(sensors: dict[str, SensorFolder]) -> Iterator[Figure]:
    """Yield whether something touches where one reference image of a real sensor is measured against another of another time."""
    for name in (name for name in sensors if name.startswith("sensor")):
        images, folder, touched = calibration_images(name), sensors[name], 0
        pair = np.asarray(images.board_reference), np.asarray(images.ball_reference)
        for before, after in (pair, pair[::-1]):
            reading = read_frame(Frame(after), folder.shape, folder.shape.depth_reader(Frame(before)))
            touched += is_touched(folder.estimator("physics").add_force(reading))
        yield at_most(f"{name}: contacts in two reference images of other times", touched, 0)


def compare_press(
    folder: SensorFolder, reference: Image, image: Image, change: Callable[[Image], Image]
) -> tuple[float, float, bool]:
    """Return depth and normal force over those of the press unchanged, and whether there is a warning of light or dirt."""
    reader, readings = folder.shape.depth_reader(Frame(reference)), []
    for one in (image, np.clip(np.rint(change(image.astype(np.float32))), 0, 255).astype(np.uint8)):
        readings.append(folder.estimator("physics").add_force(read_frame(Frame(one), folder.shape, reader)))
    before, after = readings
    assert before.wrench is not None and after.wrench is not None
    depth = after.max_indentation_mm / before.max_indentation_mm
    force = float(after.wrench.force_n[2] / before.wrench.force_n[2])
    return depth, force, bool(set(after.warnings) - set(before.warnings))


if __name__ == "__main__":
    tyro.cli(changing_light)

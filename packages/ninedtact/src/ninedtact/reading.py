"""The result of one frame: the image, the shape of the gel surface and, where an estimator runs, the wrench."""

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property
from time import perf_counter

import cv2
import numpy as np
from jaxtyping import Bool, Float32, Float64, UInt8
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.quantities import EstimateWarning, Frame, HeightMap, PointCloud, Rectified, Wrench, WrenchEstimate
from ninedtact.shape.calibrated_shape import CalibratedShape, DepthReader
from ninedtact.shape.contacts import ContactPatch, find_contacts
from ninedtact.shape.image_plausibility import find_image_warnings
from ninedtact.shape.light_change import LightChange
from ninedtact.shape.model_inputs import TactileModel, prepare_model_input
from ninedtact.shape.surface import ShapeSummary, contact_mask, point_cloud, summarise_shape


@dataclass(frozen=True)
class Flicker:
    """An oscillation of the brightness of a stream."""

    amplitude: float
    """Half of the difference between bright and dark, relative to the brightness."""
    period_s: float
    """Period as the images show it; a lamp that is faster than half of the frame rate appears slower than it is."""


@dataclass(frozen=True, eq=False)
class CellNoise:
    """The noise of a stream on every cell of the contact detection, learnt from images without contact."""

    mean_square: Float32[Array, "cell_rows cell_cols"]
    """Mean square of the relative darkening of a cell."""
    step_square: float
    """Mean square of its change from image to image, of all cells."""
    images: int

    @property
    def is_known(self) -> bool:
        """Whether the images were enough, and their noise is new in each. A codec that carries its error from image to image shows
        one error for seconds, and then another."""
        return self.images >= _ENOUGH_IMAGES and self.step_square >= float(self.mean_square.mean())

    @cached_property
    def std(self) -> Float32[Array, "cell_rows cell_cols"]:
        """Standard deviation of every cell. As it rests on few images, that of all cells is added to its own."""
        return np.sqrt(self.mean_square + self.mean_square.mean())


_ENOUGH_IMAGES = 30
CELL_MM = 0.53
_STEP_OF_GAIN = 0.008
"""Change of the gain from one image to the next that no drift of the light makes."""


@dataclass(frozen=True)
class StreamMemory:
    """What earlier images of a stream without contact told, which decides with the image itself whether something touches.

    Images that are read alone, and those of recordings beyond their reference images, have no memory: all of it is zero.
    """

    noise: float = 0.0
    """Largest noise of images without contact, after smoothing over a millimetre, relative to the brightness."""
    darkening: float = 0.0
    """Largest darkening of images without contact, smoothed and relative alike; zero where none was looked at."""
    learnt_s: float = 0.0
    """Time over which the noise was learnt."""
    gains: tuple[float, float] = (1.0, 1.0)
    """Least and greatest gain of the light so far (`LightChange.gain`)."""
    flicker: Flicker | None = None
    cell_noise: CellNoise | None = None
    """Noise of every cell; None where it was not learnt."""
    last_darkenings: tuple[Float32[Array, "cell_rows cell_cols"], ...] = field(default=(), compare=False)
    """Darkening of every cell (`measure_darkening_on_cells`) in the last images in which contact was looked for."""

    def knows_light(self, gain: float) -> bool:
        """Return whether the light did not change in a step, as when a camera regulates, which rounds grey levels otherwise."""
        least, most = self.gains
        return least - _STEP_OF_GAIN < gain < most + _STEP_OF_GAIN


@checks_arguments
@dataclass(frozen=True)
class Reading:
    """Everything computed from one frame, with the cost of each stage.

    Measures of the contact and points are computed when they are first asked for.

    >>> with ninedtact.open("my_sensor", source="sim", force="none") as sensor:
    ...     reading = sensor.read()
    >>> reading.image.shape, reading.height.z_mm.shape, reading.warnings
    ((480, 640, 3), (345, 460), ())
    """

    frame: Frame
    rectified: Rectified
    """The image on the skin's grid, in the light of the reference image: `light` says what was taken out."""
    height: HeightMap
    reference: Rectified
    """Rectified reference image (no contact) that the heights were computed against."""
    stage_ms: dict[str, float] = field(default_factory=dict)
    """Duration of each stage in ms: capture, rectify (with the light), depth, force."""
    dropped: int = 0
    """Number of frames that were never read, of those that the source delivered since it was opened, or that a recording holds
    since its first."""
    force: WrenchEstimate | None = None
    """The estimate with all its parts; None where the sensor has no estimator."""
    reference_warnings: tuple[EstimateWarning, ...] = ()
    """Reasons to distrust the calibration, or why the reference image cannot be that of the calibrated sensor; empty where neither
    was checked.
    """
    light: LightChange = LightChange()
    """What changed in the light since the reference image, and the dirt in view."""
    stream: StreamMemory = StreamMemory()
    """What was remembered of earlier images, and used to tell contact from noise."""
    calibration_checksum: str = ""
    """That of the calibration that the image was read with, by which an estimator knows its sensor; empty where it is not known."""

    @checks_arguments
    def with_force(self, estimate: WrenchEstimate) -> "Reading":
        """Return the same reading with an estimate; what has been computed from the image is kept, not computed again."""
        reading = copy(self)  # with the cached properties, unlike `dataclasses.replace`
        reading.__dict__.pop("contacts", None)  # the only one of them that depends on the force
        object.__setattr__(reading, "force", estimate)
        return reading

    @property
    def image(self) -> UInt8[Array, "rows cols 3"]:
        """The raw camera image, BGR, shape (rows, cols, 3)."""
        return self.frame.image

    @property
    def stamp_ns(self) -> int:
        """Arrival time of the frame on the monotonic clock, ns."""
        return self.frame.stamp_ns

    @property
    def wrench(self) -> Wrench | None:
        """Force in N and torque in N·m that the object applies to the skin; None where the sensor has no estimator."""
        return None if self.force is None else self.force.wrench

    @property
    def wrench_std(self) -> Float64[Array, "6"] | None:
        """One standard deviation of F_x, F_y, F_z in N and T_x, T_y, T_z in N·m; None where the sensor has no estimator."""
        return None if self.force is None else self.force.std

    @property
    def warnings(self) -> tuple[EstimateWarning, ...]:
        """Reasons to distrust the reading, for example a press beyond the calibrated range; empty where there are none."""
        of_force = () if self.force is None else self.force.warnings
        flickers = () if self.stream.flicker is None else (EstimateWarning.LIGHT_FLICKERS,)
        of_light = (*self.light.warnings, *flickers)
        return tuple(dict.fromkeys((*self.reference_warnings, *self.image_warnings, *of_light, *of_force)))

    @property
    def light_sentences(self) -> tuple[str, ...]:
        """Changes of the light, dirt and flicker in words, with figures; empty where there are none."""
        flicker = self.stream.flicker
        if flicker is None:
            return self.light.sentences
        return (*self.light.sentences, f"flicker of ±{flicker.amplitude:.1%} with a period of {flicker.period_s:.2f} s")

    @cached_property
    def brightness_on_cells(self) -> Float32[Array, "cell_rows cell_cols"]:
        """The brightness relative to the reference image, on square cells of about half a millimetre, for the contact detection."""
        shape = self.rectified.grey.shape
        rows, cols = (max(round(side * self.rectified.mm_per_px / CELL_MM), 1) for side in shape)
        image, reference = (
            cv2.resize(one.grey, (cols, rows), interpolation=cv2.INTER_AREA) for one in (self.rectified, self.reference)
        )
        return np.asarray(image / np.maximum(reference, np.float32(1)))

    @cached_property
    def image_warnings(self) -> tuple[EstimateWarning, ...]:
        """Reasons why the image cannot be a press on this sensor, for example a failed LED; empty for a plausible image."""
        knows_depth = EstimateWarning.NOT_CALIBRATED not in self.reference_warnings
        return find_image_warnings(self.rectified, self.reference, self.height, self.light, knows_depth)

    @cached_property
    def summary(self) -> ShapeSummary:
        """All measures of the contact: depth, area, volume, centre."""
        return summarise_shape(self.height, touched=self.contact)

    @cached_property
    def contact(self) -> Bool[Array, "rows cols"]:
        """The pixels of the height map at which something touches, judged by depth.

        `force.touching` is judged by brightness before any depth is known, so that the two may differ for the lightest contacts.
        """
        return contact_mask(self.height)

    @property
    def is_touching(self) -> bool:
        """Whether something touches: judged by the estimate where there is one, otherwise by depth."""
        return bool(self.contact.any()) if self.force is None else self.force.touching

    @cached_property
    def contacts(self) -> tuple[ContactPatch, ...]:
        """The connected contacts, the largest first, each with its share of the wrench; empty where nothing touches."""
        return find_contacts(self.height, self.contact, self.force) if self.is_touching else ()

    @property
    def max_indentation_mm(self) -> float:
        """Maximum indentation in view, mm; 0 where nothing is indented."""
        return self.summary.max_indentation_mm

    @property
    def contact_area_mm2(self) -> float:
        """Area of the contact, measured on the plane of the untouched skin, mm²."""
        return self.summary.contact_area_mm2

    def points(self) -> PointCloud:
        """Return the surface as points with outward unit normals, mm, in the sensor frame."""
        return point_cloud(self.height)

    @checks_arguments
    def model_input(self, model: TactileModel, earlier: "Reading | None" = None) -> Float32[Array, "..."]:
        """Return the image as the input of a published tactile model: sparsh, htt or anytouch (`shape.model_inputs`).

        earlier: the other reading of a pair, 83 ms earlier for sparsh and the one before for htt; None takes this one twice.
        Raises `InputError`.

        >>> with ninedtact.open("my_sensor", source="sim", force="none") as sensor:
        ...     before, now = sensor.read(), sensor.read()
        >>> now.model_input("htt", before).shape
        (2, 3, 224, 224)
        """
        other = None if earlier is None else earlier.rectified
        return prepare_model_input(model, self.rectified, self.reference, other)

    @checks_arguments
    def age_ms(self, now_ns: int) -> float:
        """Return the time since the frame arrived, given the present `time.monotonic_ns()`."""
        return (now_ns - self.frame.stamp_ns) / 1e6


class Stopwatch:
    """Durations in ms between successive marks."""

    def __init__(self) -> None:
        self.stage_ms: dict[str, float] = {}
        self._last = perf_counter()

    def mark(self, stage: str) -> None:
        """Assign the time since the last mark to the given stage."""
        now = perf_counter()
        self.stage_ms[stage], self._last = (now - self._last) * 1e3, now


def read_frame(
    frame: Frame,
    shape: CalibratedShape,
    depth_reader: DepthReader,
    watch: Stopwatch | None = None,
    dropped: int = 0,
    stream: StreamMemory = StreamMemory(),
) -> Reading:
    """Return the reading of a frame: its shape against a reference image, still without a wrench.

    depth_reader: of the same calibration, with the reference image. watch: measures the stages. dropped: number of frames that
    were never read. stream: what earlier images told. Raises `FileFormatError`.
    """
    watch = Stopwatch() if watch is None else watch
    rectified, light = shape.light(shape.rectify(frame), depth_reader.reference)
    watch.mark("rectify")
    height = depth_reader(rectified)
    watch.mark("depth")
    doubts = (EstimateWarning.REFERENCE_UNLIKE_CALIBRATION,) if depth_reader.reference_faults else ()
    reference, warnings = depth_reader.reference, (*shape.warnings, *doubts)
    return Reading(
        frame,
        rectified,
        height,
        reference,
        watch.stage_ms,
        dropped,
        None,
        warnings,
        light,
        stream,
        shape.calibration_checksum,
    )

"""A calibrated sensor on disk: `sensor.toml`, the calibration images in `images/`, and `certificate.html`.

`load_sensor` reads and checks a folder. What it returns gives the calibrated shape path, the stored images, the sensor's digital
twin and a force estimator. Writing is in `calibration.save`.
"""

from dataclasses import dataclass
from functools import cached_property
from hashlib import sha256
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.calibration.sensor_toml_schema import (
    NOT_CALIBRATED,
    SENSOR_FORMAT,
    DepthTable,
    LensModelTable,
    PinMapTable,
    PixelMapTable,
    SensorTomlRecord,
    TwinTable,
    sensor_record_checksum,
)
from ninedtact.capture.strict_image_reading import read_image
from ninedtact.checked_reading import (
    CHECKSUM_KEY,
    convert_tables_to_class,
    mapping_checksum,
    parse_toml,
    read_regular_file,
    read_text_file,
)
from ninedtact.design import Gel
from ninedtact.errors import CalibrationError, FileFormatError, NinedtactError
from ninedtact.mechanics.base_deflection import BaseDeflection
from ninedtact.quantities import EstimateWarning, Frame, HeightSource
from ninedtact.shape.calibrated_shape import CalibratedShape
from ninedtact.shape.lens_and_rectification import (
    CorrectedLensModel,
    LensModel,
    LensModelCorrection,
    Projection,
    RadialBasisProjection,
    Rectification,
    rectification_of_projection,
)

if TYPE_CHECKING:
    from ninedtact.force.estimator_and_scale import ForceEstimator, ForceScale
    from ninedtact.simulation.twin import Twin

SENSOR_FILE = "sensor.toml"
_MIN_INVERSE_DISTANCE_PER_MM = 1e-4
"""Inverse viewing distance below which lines of sight count as parallel."""
_MIN_VIEW_SHARE = 0.2
"""Smallest share of the rectified image that a lens shows; those of real sensors show nine tenths and more."""


class SensorFolderDamaged(FileFormatError):
    """The folder is not a sensor folder, a file in it is missing or changed, or its format is not supported."""


@checks_arguments
@dataclass(frozen=True)
class SensorFolder:
    """One sensor's folder, read and checked.

    >>> folder = ninedtact.load_sensor("my_sensor")
    >>> folder.shape.depth_range_mm > 1
    True
    """

    path: Path
    record: SensorTomlRecord
    is_edited: bool = False
    """Whether the numbers of `sensor.toml` differ from those that the calibration wrote, or have no checksum that tells."""
    has_checksum: bool = True

    @property
    def notices(self) -> tuple[str, ...]:
        """A sentence for each reason to distrust the calibration; empty for one that passed its checks and is as it was written."""
        from ninedtact.calibration.certificate.checks import has_failed_checks

        reason = "its checksum is not that of its numbers" if self.has_checksum else "it has no checksum"
        edited = (
            f"{self.path / SENSOR_FILE} was edited or damaged after the calibration: {reason}; restore the sensor folder or "
            "calibrate again if you did not edit it"
        )
        notices = [edited] if self.is_edited else []
        if has_failed_checks(self.record.certificate):
            notices.append(
                f"the calibration of {self.path} failed its checks; do not measure with it, and calibrate again as its "
                "certificate.html advises"
            )
        return tuple(notices)

    @property
    def id(self) -> str:
        """Return the name of the sensor."""
        return self.record.id

    @cached_property
    def calibration_checksum(self) -> str:
        """The checksum of all calibrated numbers, as in `sensor.toml`; sensors of one checksum are calibrated alike."""
        return sensor_record_checksum(self.record)

    @cached_property
    def shape(self) -> CalibratedShape:
        """The calibrated path from a camera frame to a height map."""
        depth, certificate = self.depth, self.record.certificate
        return CalibratedShape(
            self.rectification,
            depth.curve,
            depth.noise_mm,
            self.viewing_distance_mm,
            depth.smoothing,
            depth.dimming,
            depth.deblurring,
            None if self.record.twin is None else BaseDeflection(self.record.twin.gel, depth.base_stiffening),
            (EstimateWarning.CALIBRATION_EDITED,) if self.is_edited else (),
            None if certificate is None or certificate.ball is None else certificate.ball.range_mm,
            self.calibration_checksum,
        )

    @property
    def depth(self) -> DepthTable:
        """The calibrated depth; raises `CalibrationError` for a sensor that was calibrated with the board alone."""
        if self.record.depth is None:
            raise self._depth_not_calibrated()
        return self.record.depth

    def _depth_not_calibrated(self) -> CalibrationError:
        """Return the error of a sensor that was calibrated with the board alone."""
        return CalibrationError(
            expected=f"{self.path} to be calibrated for depth",
            got="a sensor calibrated with the board alone, which rectifies images and gives no heights and no force",
            remedy=f"press the ball and run: {self.completion_command}",
        )

    @property
    def is_imported(self) -> bool:
        """Whether the rectification is that of an imported calibration."""
        return isinstance(self.record.lens, PixelMapTable)

    @property
    def completion_command(self) -> str:
        """The command that adds the twin, from the stored images of the ball or from new ones."""
        path = quote(str(self.path))
        if "ball" in self.record.images:
            return f"ninedtact simulate fit --sensor {path}"
        origin = f"--from-import {path} " if self.is_imported else ""
        return f"ninedtact calibrate {origin}--out {path} --ball-reference REFERENCE.png --ball BALL.png"

    def require_twin(self) -> TwinTable:
        """Return the table of the twin; raises `CalibrationError` where the calibration fitted none."""
        if self.record.twin is None:
            raise CalibrationError(
                expected=f"{self.path} to hold a twin",
                got="a sensor without one",
                remedy=f"run: {self.completion_command}",
            )
        return self.record.twin

    @property
    def gel(self) -> Gel:
        """The gel as fitted to the ball image and to known loads, or as designed where there is no such fit."""
        return self.record.design.gel if self.record.twin is None else self.record.twin.gel

    @property
    def viewing_distance_mm(self) -> float:
        """Distance from which the skin is viewed: as fitted to the ball press by the method `physics`, otherwise as designed."""
        if self.depth.method != "physics" or self.record.twin is None:
            return self.record.design.camera.distance_mm
        inverse_distance_per_mm = self.record.twin.light.inverse_distance_per_mm
        return 1 / inverse_distance_per_mm if inverse_distance_per_mm > _MIN_INVERSE_DISTANCE_PER_MM else float("inf")

    @cached_property
    def rectification(self) -> Rectification:
        """The map from the raw image to the rectified grid; raises `SensorFolderDamaged`."""
        grid, lens = self.record.grid, self.record.lens
        raw_shape = (grid.raw_rows, grid.raw_cols)
        if isinstance(lens, PixelMapTable):
            source_px = _read_pixel_map(self._verify_file(lens.file, lens.sha256), self.record)
            rectify = Rectification(source_px, grid.mm_per_px, raw_shape, grid.calibrated_area_mm)
        else:
            field_of_view = self.record.design.field_of_view
            rectify = rectification_of_projection(
                build_projection(lens, raw_shape), field_of_view, grid.mm_per_px, raw_shape, grid.calibrated_area_mm
            )
        share = float((rectify.height_source != HeightSource.OUT_OF_VIEW).mean())
        if share < _MIN_VIEW_SHARE:
            raise SensorFolderDamaged(
                expected=f"a lens in {self.path / SENSOR_FILE} that sees the skin",
                got=f"one that sees {share:.0%} of it",
                remedy="restore the sensor folder or calibrate again",
            )
        return rectify

    @checks_arguments
    def stored_image(self, name: str) -> Frame:
        """Read an image that the sensor was calibrated from: `board_reference`, `board`, `ball_reference` or `ball`.

        Raises `SensorFolderDamaged` where it is missing or changed, and `CalibrationError` for an image of the ball that was not
        pressed yet. Imported sensors have no images of a board.
        """
        if name not in self.record.images:
            if name.startswith("ball") and self.record.depth is None:
                raise self._depth_not_calibrated()
            advice = "calibrate again" if name.startswith("board") else f"run: {self.completion_command}"
            kind = "an imported sensor" if self.is_imported else "a sensor"
            raise SensorFolderDamaged(
                expected=f"{self.path} to hold the image {name!r}", got=f"{kind} without it", remedy=f"{advice}"
            )
        entry = self.record.images[name]
        return Frame(read_image(self._verify_file(entry.file, entry.sha256)))

    @cached_property
    def reference_grey(self) -> Float32[Array, "rows cols"] | None:
        """The rectified image of the untouched skin in grey levels; None for an imported sensor, which has no images."""
        name = next((name for name in ("ball_reference", "board_reference") if name in self.record.images), None)
        return None if name is None else self.rectification(self.stored_image(name)).grey

    def twin(self) -> "Twin":
        """Build the sensor's digital twin from what its ball press showed of gel and light.

        Raises `CalibrationError` where the calibration fitted none (`--method ratio` or `table`, imported sensors), and
        `SensorFolderDamaged` where its images are missing.

        >>> twin = ninedtact.load_sensor("my_sensor").twin()
        """
        from ninedtact.calibration.twin.sensor_twin import assemble_twin

        table = self.require_twin()
        reference, area = self.stored_image("ball_reference").image, self.record.design.sensing_area
        return assemble_twin(
            self.id, table.gel, table.light, self.rectification, reference, table.noise_grey_levels, area
        )

    @checks_arguments
    def estimator(self, spec: str = "physics", with_force_scale: bool = True) -> "ForceEstimator":
        """Build a force estimator for this sensor, with the force scale of its folder.

        Where the folder has none, the spread of the gel's modulus is part of the stated errors.

        spec: `physics`, `none`, or the path of a force model (.onnx) or of the original project's weights (.pt). with_force_scale:
        without, forces are those before the calibration with known loads. Raises `InputError`, `ForceModelUnusable`,
        `FileFormatError`, and `ForceEstimationError` for a sensor that was imported or calibrated without scattering of light.

        >>> estimator = ninedtact.load_sensor("my_sensor").estimator("physics")
        >>> estimator.name
        'force by physics'
        """
        from ninedtact.force.estimator_and_scale import apply_sensor_force_scale
        from ninedtact.force.estimator_loading import NONE, PHYSICS, build_estimator

        if spec == PHYSICS and self.shape.deblurring is None:
            from ninedtact.errors import ForceEstimationError

            raise ForceEstimationError(
                expected=f"{self.path} to be calibrated for force by physics",
                got="a calibration that does not know how the gel scatters light (imported, or of another method than 'physics')",
                remedy=f"run: {self.completion_command}",
            )
        estimator = build_estimator(spec, self.shape, self.gel)
        if not with_force_scale or spec == NONE:
            return estimator
        return apply_sensor_force_scale(estimator, self.path, self.gel_force_scale if spec == PHYSICS else None)

    @property
    def gel_force_scale(self) -> "ForceScale | None":
        """The error of forces by physics that known loads leave, or, without any, the ball of the calibration; None without a
        twin."""
        from ninedtact.force.estimator_and_scale import ForceScale, force_scale_of_ball

        known, twin = self.record.known_loads, self.record.twin
        if known is not None:
            return ForceScale(1.0, known.error, known.presses, known.shear_factor, known.shear_std)
        return None if twin is None else force_scale_of_ball(twin.modulus_ratio_std)

    def _verify_file(self, file: str, digest: str) -> Path:
        """Return the path of a file of the folder after its content has been checked against the stored hash."""
        path = self.path / file
        if not path.exists():
            raise SensorFolderDamaged(
                expected=f"{path}", got="no such file", remedy="restore the sensor folder or calibrate again"
            )
        try:
            content = read_regular_file(path)
        except OSError as trouble:
            raise SensorFolderDamaged(
                f"expected to read {path}, got: {trouble}; restore the sensor folder or calibrate again"
            ) from trouble
        if sha256(content).hexdigest() != digest:
            raise SensorFolderDamaged(
                expected=f"{path} as it was calibrated with",
                got="other content",
                remedy="restore the sensor folder or calibrate again",
            )
        return path


@checks_arguments
def load_sensor(folder: Path | str) -> SensorFolder:
    """Read and check a sensor folder; return it as a `SensorFolder`.

    Raises `SensorFolderDamaged`, also for a folder of another format.

    >>> folder = ninedtact.load_sensor("my_sensor")
    """
    path = Path(folder)
    try:
        text = read_text_file(path / SENSOR_FILE)
    except (OSError, UnicodeDecodeError) as trouble:
        raise SensorFolderDamaged(
            expected=f"a sensor folder with a readable {SENSOR_FILE}",
            got=f"{path} ({trouble})",
            remedy="give the folder that 'ninedtact calibrate --out' wrote",
        ) from trouble
    record, checksum, own = _parse_record(path, text)
    return SensorFolder(path, record, checksum != own, checksum is not None)


def _parse_record(folder: Path, text: str) -> tuple[SensorTomlRecord, Any, str]:
    """Parse the text of `sensor.toml` and check every field; return the checksum that it states, too, and that of its numbers."""
    try:
        tables = parse_toml(text)
        _require_current_format(folder, tables)
        checksum = tables.pop(CHECKSUM_KEY, None)
        return convert_tables_to_class(tables, SensorTomlRecord), checksum, mapping_checksum(tables, NOT_CALIBRATED)
    except SensorFolderDamaged:
        raise
    except (ValueError, RecursionError, NinedtactError) as trouble:
        raise SensorFolderDamaged(
            f"expected {folder / SENSOR_FILE} as the program wrote it, got: {trouble}; restore the sensor folder or calibrate again"
        ) from trouble


def checksum_of_sensor_toml(content: bytes) -> str:
    """Return `SensorFolder.calibration_checksum` of the content of `sensor.toml`; empty where it cannot be read."""
    try:
        return mapping_checksum(parse_toml(content.decode("utf-8-sig")), NOT_CALIBRATED)
    except ValueError:
        return ""


def _require_current_format(folder: Path, tables: dict[str, Any]) -> None:
    """Refuse a file of another format; raises `SensorFolderDamaged`."""
    version = tables.get("format")
    if isinstance(version, int) and version != SENSOR_FORMAT:
        raise SensorFolderDamaged(
            expected=f"{folder / SENSOR_FILE} in format {SENSOR_FORMAT}",
            got=f"format {version} of another version of ninedtact",
            remedy="calibrate the sensor again with 'ninedtact calibrate --images' from its own images, or install that version",
        )


def build_projection(lens: LensModelTable | PinMapTable, raw_shape: tuple[int, int]) -> Projection:
    """Return the projection from the skin to the raw image that a table of `sensor.toml` describes."""
    if isinstance(lens, LensModelTable):
        model, table = LensModel(lens.homography, lens.centre, lens.radial, lens.tangential, raw_shape), lens.correction
        if table is None:
            return model
        correction = LensModelCorrection(np.array(table.points_mm), np.array(table.weights_px), table.width_mm)
        return CorrectedLensModel(model, correction)
    return RadialBasisProjection(np.array(lens.points_mm), np.array(lens.points_px))


def _read_pixel_map(path: Path, record: SensorTomlRecord) -> np.ndarray:
    """Read a stored rectification, float32 (rows, cols, 2)."""
    view = record.design.field_of_view
    source_px = np.load(path, allow_pickle=False)
    if source_px.shape != (view.rows, view.cols, 2):
        raise SensorFolderDamaged(
            expected=f"{path} of shape {(view.rows, view.cols, 2)}",
            got=f"{source_px.shape}",
            remedy="restore the sensor folder",
        )
    return np.asarray(source_px, np.float32)

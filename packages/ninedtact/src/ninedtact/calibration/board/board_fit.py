"""The fit of the pin board: one press of the board → the lens model, that is, where every point of the skin appears in the image.
In: the raw reference image and the raw image of the press. Out: `BoardFit`, from `fit_board`.

    images → relative change → dark spots → lattice → lens → imprint centres on the skin → lens

No threshold needs tuning by the user: spots compete as lattices, and a lattice is rated by how well a lens explains it.
`PublishedPinMap` is the paper's camera calibration on the same pins, for reproduction and as the baseline in every certificate.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Float32, Int
from numpy import ndarray as Array
from scipy import ndimage
from scipy.interpolate import RBFInterpolator

from ninedtact.calibration.board.detection import (
    BoardCandidate,
    find_board_candidate,
    is_plausible_board,
    lattice_size,
    lattice_to_skin_mm,
    make_board_not_found_error,
)
from ninedtact.calibration.board.lens_fit import (
    MIN_CORRECTED_ERROR,
    LensCorrectionFit,
    LensFit,
    fit_lens,
    fit_smooth_lens_residual,
    rms_vector_length,
)
from ninedtact.calibration.board.pin_imprint_centres import (
    IMPRINT_RADIUS_PITCHES,
    find_stray_pins,
    imprint_radius_mm,
    locate_imprints_mm,
    measure_pins,
)
from ninedtact.calibration.brightness_change import (
    estimate_pixel_noise,
    flat_fielded_brightness_change,
    require_same_image_size,
    require_usable_exposure,
    smooth_gaussian,
)
from ninedtact.calibration.sensor_toml_schema import MAX_MISSING_FRACTION
from ninedtact.calibration.settings import LensKind
from ninedtact.design import PinBoard, SensorDesign
from ninedtact.errors import CalibrationError, InputError
from ninedtact.quantities import BgrImage
from ninedtact.shape.lens_and_rectification import (
    Area,
    CameraRotation,
    CorrectedLensModel,
    LensModel,
    Points,
    Projection,
    RadialBasisProjection,
    Rectification,
    central_mm_per_px,
    rectification_of_projection,
)

_REFINEMENT_ITERATIONS = 4
_PITCH_PER_PIN = PinBoard().pitch_mm / PinBoard().pin_diameter_mm
"""Largest pitch, in diameters of a pin, by which an imprint is measured."""
SMOOTHING_PX = 1.0
_MAX_FURTHER_SHARE = 0.6
"""Share of the pins of a further row or column that are found where the board has one."""


@dataclass(frozen=True)
class BoardFit:
    """All pins of the board, and the lens model fitted to them."""

    board: PinBoard
    mounting: CameraRotation
    lens_fit: LensFit
    nodes: Int[Array, "n 2"]
    """Lattice node of every pin, (column, row) along the image's axes."""
    points_mm: Points
    points_px: Points
    """Detected position where `found`, predicted by the lens elsewhere."""
    found: Bool[Array, " n"]
    contrast: Float[Array, " n"]
    """Depth of each imprint in grey levels."""
    noise: float
    """Standard deviation of one pixel of `change`, the difference of two images, in grey levels."""
    change: Float32[Array, "rows cols"]
    refined: LensModel | None = None
    """A lens that was fitted to the whole image, not to the imprints' centres alone (`calibration.twin.lens_refinement`)."""
    correction: LensCorrectionFit | None = None
    """A smooth correction on top of the lens, where it predicts left-out pins better."""

    @property
    def lens(self) -> LensModel:
        """Return the lens of the fit, the refined one where there is one."""
        return self.lens_fit.lens if self.refined is None else self.refined

    @property
    def projection(self) -> Projection:
        """Return the lens with its correction, where it has one."""
        return self.lens if self.correction is None else CorrectedLensModel(self.lens, self.correction.correction)

    @property
    def mm_per_px(self) -> float:
        """mm on the skin per raw pixel around the centre."""
        return central_mm_per_px(self.projection, self.board.pitch_mm)

    @cached_property
    def imprint_radius_mm(self) -> float:
        """Radius at which the imprints of the found pins are half as dark as in the middle."""
        image = smooth_gaussian(self.change, SMOOTHING_PX)
        # The depth counts from the ring around the imprint, so that pins far apart are measured as those of the published board.
        pitch_mm = min(self.board.pitch_mm, _PITCH_PER_PIN * self.board.pin_diameter_mm)
        reach_mm = IMPRINT_RADIUS_PITCHES * pitch_mm
        centres_mm = locate_imprints_mm(image, self.projection, self.points_mm[self.found], reach_mm)
        return imprint_radius_mm(image, self.projection, centres_mm, reach_mm)

    @property
    def relative_scale_std(self) -> float:
        """Relative standard error of the mm per pixel."""
        return self.lens_fit.mm_per_px_std(self.board.pitch_mm) / central_mm_per_px(self.lens, self.board.pitch_mm)

    @property
    def camera_noise_grey_levels(self) -> float:
        """Standard deviation of one pixel of one image."""
        return self.noise / 2**0.5

    def lens_of_kind(self, kind: LensKind) -> "BoardFit | PublishedPinMap":
        """Return what was fitted to the pins: the lens model, or the paper's map. Both have a projection, a scale and errors."""
        return self.published_map if kind == "paper" else self

    @cached_property
    def published_map(self) -> "PublishedPinMap":
        """The paper's calibration on the same pins. Predicted pins, which may be out of view, stay where the lens predicts them."""
        reach_px = round(0.45 * self.board.pitch_mm / central_mm_per_px(self.lens, self.board.pitch_mm))
        image, centres_px = smooth_gaussian(self.change, 1.5), self.points_px.copy()
        centres_px[self.found] = [_integer_spot_centre(image, point, reach_px) for point in self.points_px[self.found]]
        return PublishedPinMap(self.board, self.points_mm, centres_px, self.found)

    @property
    def leave_one_out_errors_mm(self) -> Points:
        """Return, for every found pin, its position as predicted from all others, minus its true position, in mm on the skin."""
        return (self.lens_fit if self.correction is None else self.correction).leave_one_out_errors_mm

    @property
    def missing_pins(self) -> list[str]:
        """Return the names of the pins that were predicted."""
        return [f"column {column + 1}, row {row + 1}" for column, row in self.nodes[~self.found].tolist()]

    @property
    def warnings(self) -> list[str]:
        """Warnings about the press of the board: pins that were not found, and a large leave-one-out error."""
        warnings = []
        if self.missing_pins:
            warnings.append(
                f"found {int(self.found.sum())} of {self.board.count} pins; predicted from the others: "
                f"{'; '.join(self.missing_pins)}; press harder there, or hold the board flatter, for a better lens"
            )
        error_mm = rms_vector_length(self.leave_one_out_errors_mm)
        if error_mm > 0.04 * self.board.pitch_mm:
            warnings.append(
                f"pins are predicted only to {error_mm:.2f} mm (0.03 to 0.06 mm is usual); "
                "focus the camera and press the board evenly"
            )
        return warnings


def fit_board(
    reference: BgrImage,
    press: BgrImage,
    board: PinBoard,
    mounting: CameraRotation | Literal["auto"] = "auto",
    mirrored: bool = False,
) -> BoardFit:
    """Find the pins with sub-pixel accuracy and fit the lens; raises `BoardNotFound`, `CalibrationError`.

    reference, press: raw images (rows, cols, 3) of the skin without contact and of the pressed skin, of one size. mirrored: whether
    the camera mirrors them left to right, which no board shows.
    """
    require_same_image_size("board image", reference, press)
    require_usable_exposure("board reference", reference)
    require_usable_exposure("board image", press)
    change = flat_fielded_brightness_change(reference, press)
    candidate = find_board_candidate(change, board, mounting, mirrored)
    if candidate is None or not is_plausible_board(candidate, board):
        seen_px = candidate.consistent_spots_px(board) if candidate else np.empty((0, 2))
        raise make_board_not_found_error(change, board, seen_px, candidate)
    return _refine_pins_and_lens(change, board, candidate)


def _refine_pins_and_lens(change: Float32[Array, "rows cols"], board: PinBoard, candidate: BoardCandidate) -> BoardFit:
    """Refine imprint centres and lens in turn, and search for undetected pins where the lens predicts them."""
    cols, rows = lattice_size(board, candidate.mounting)
    nodes = np.array([(column, row) for row in range(rows) for column in range(cols)])
    points_mm = lattice_to_skin_mm(nodes, board, candidate.mounting, candidate.mirrored)
    image, noise, fit = smooth_gaussian(change, SMOOTHING_PX), estimate_pixel_noise(change), candidate.fit
    strays = np.zeros(len(nodes), bool)
    for _ in range(_REFINEMENT_ITERATIONS):
        points_px, contrast, found = measure_pins(image, fit.lens, points_mm, noise, board)
        found &= ~strays
        _require_enough_pins(change, board, nodes, found, points_px, candidate)
        fit = fit_lens(points_mm[found], points_px[found], fit.lens)
        strays[np.flatnonzero(found)[find_stray_pins(fit, board)]] = True
    _require_no_further_pins(image, noise, board, candidate, fit.lens, points_mm)
    where = np.where(found[:, None], points_px, fit.lens.to_px(points_mm))
    return _add_correction(
        BoardFit(board, candidate.mounting, fit, nodes, points_mm, where, found, contrast, noise, change)
    )


def _add_correction(fit: BoardFit) -> BoardFit:
    """Return the board with a smooth correction of its lens, where the lens alone predicts left-out pins badly, or worse than the
    paper's map does, and the correction improves that.
    """
    correction = fit_smooth_lens_residual(fit.lens_fit, fit.board.pitch_mm)
    if correction is None:
        return fit
    error_mm = fit.lens_fit.leave_one_out_rms_mm
    is_needed = error_mm > MIN_CORRECTED_ERROR * fit.board.pitch_mm or error_mm > fit.published_map.leave_one_out_rms_mm
    return replace(fit, correction=correction) if is_needed else fit


def _require_enough_pins(
    change: Float32[Array, "rows cols"],
    board: PinBoard,
    nodes: Int[Array, "n 2"],
    found: Bool[Array, " n"],
    points_px: Points,
    candidate: BoardCandidate,
) -> None:
    """Refuse a board with too many pins missing, or with a whole side missing, which leaves its row or column ambiguous."""
    last = nodes.max(axis=0)
    sides = [found[nodes[:, axis] == end].any() for axis in (0, 1) for end in (0, last[axis])]
    if (~found).sum() > MAX_MISSING_FRACTION * board.count or not all(sides):
        raise make_board_not_found_error(
            change, board, max(points_px[found], candidate.consistent_spots_px(board), key=len), candidate
        )


def _require_no_further_pins(
    image: Float32[Array, "rows cols"],
    noise: float,
    board: PinBoard,
    candidate: BoardCandidate,
    lens: LensModel,
    board_mm: Points,
) -> None:
    """Refuse a board with a row or column of pins more than its design: its middle pin is then ambiguous."""
    cols, rows = lattice_size(board, candidate.mounting)
    sides = [[(column, row) for row in range(rows)] for column in (-1, cols)]
    sides += [[(column, row) for column in range(cols)] for row in (-1, rows)]
    for nodes in sides:
        points_mm = lattice_to_skin_mm(np.array(nodes), board, candidate.mounting, candidate.mirrored)
        found = measure_pins(image, lens, np.concatenate([board_mm, points_mm]), noise, board)[2]
        if found[len(board_mm) :].mean() > _MAX_FURTHER_SHARE:
            raise CalibrationError(
                expected=f"{board.count} pins ({board.cols} x {board.rows})",
                got="a board with another row or column of pins beside them",
                remedy="state the numbers of the board that was pressed (--design.pin-board.rows, --design.pin-board.cols)",
            )


def build_rectification(board: BoardFit, design: SensorDesign, kind: LensKind = "model") -> Rectification:
    """Return the rectification of the design's grid through the lens fitted to the board."""
    lens = board.lens_of_kind(kind)
    rows, cols = board.change.shape
    mm_per_px = lens.mm_per_px * max(rows, cols) / design.field_of_view.raw_long_side_px
    return rectification_of_projection(
        lens.projection, design.field_of_view, mm_per_px, (rows, cols), calibrated_area_mm(design)
    )


def calibrated_area_mm(design: SensorDesign) -> Area:
    """Return the area up to one pitch beyond the outermost pins: leaving out an outermost pin tests the lens that far."""
    board = design.pin_board
    half_width_mm = (board.cols + 1) / 2 * board.pitch_mm
    half_height_mm = (board.rows + 1) / 2 * board.pitch_mm
    return -half_width_mm, half_width_mm, -half_height_mm, half_height_mm


Point = Float[Array, "2"]


@dataclass(frozen=True)
class PublishedPinMap:
    """The paper's camera calibration: a cubic radial-basis map through whole-pixel centres of the pins' spots, and the mm per pixel
    of five central anchors.
    """

    board: PinBoard
    points_mm: Points
    points_px: Points
    """Centre of each spot's pixels that are darker than half its depth, truncated to integers."""
    found: Bool[Array, " n"]

    @property
    def projection(self) -> RadialBasisProjection:
        """The map from the skin to the image, through all pins."""
        return RadialBasisProjection(self.points_mm, self.points_px)

    @property
    def mm_per_px(self) -> float:
        """mm per pixel from the mean distance of the five central anchors; raises `InputError`."""
        return float(1 / (1 / self._anchor_scales).mean())

    @property
    def relative_scale_std(self) -> float:
        """Relative standard error of the mm per pixel, from the scatter of the central pin's four distances."""
        scales = self._anchor_scales
        return float(np.std(scales, ddof=1) / np.sqrt(len(scales))) / self.mm_per_px

    @property
    def _anchor_scales(self) -> Float[Array, " k"]:
        """The pitch divided by the distance in pixels of the central pin from each of its four neighbours."""
        pitch_mm = self.board.pitch_mm
        if not (self.board.rows % 2 and self.board.cols % 2):
            raise InputError(
                expected="a board with a pin in the middle for the paper's way",
                got=f"{self.board.cols} x {self.board.rows} pins",
                remedy="use the lens model, which needs none",
            )
        distance_mm = np.hypot(*self.points_mm.T)
        middle, around = np.isclose(distance_mm, 0), np.isclose(distance_mm, pitch_mm)
        return np.asarray(pitch_mm / np.hypot(*(self.points_px[around] - self.points_px[middle]).T))

    @cached_property
    def leave_one_out_errors_mm(self) -> Points:
        """The leave-one-out errors from image to skin: each found pin is predicted by a map through all others."""
        points_mm, points_px = self.points_mm[self.found], self.points_px[self.found]
        return np.array([_leave_one_out_error_mm(points_mm, points_px, pin) for pin in range(len(points_mm))])

    @property
    def leave_one_out_rms_mm(self) -> float:
        """Root mean square length of the leave-one-out errors."""
        return rms_vector_length(self.leave_one_out_errors_mm)


def _integer_spot_centre(image: Float32[Array, "rows cols"], point_px: Point, reach_px: int) -> Point:
    """Return the integer centroid of the thresholded spot around one point."""
    column, row = np.round(point_px).astype(int)
    top, left = max(row - reach_px, 0), max(column - reach_px, 0)
    piece = image[top : row + reach_px + 1, left : column + reach_px + 1]
    level = (np.median(piece) + piece[row - top, column - left]) / 2
    spots, _ = ndimage.label(piece < level)
    rows, columns = np.nonzero(spots == spots[row - top, column - left])
    return np.floor([left + columns.mean(), top + rows.mean()])


def _leave_one_out_error_mm(points_mm: Points, points_px: Points, pin: int) -> Point:
    """Return the position of this pin as predicted by the other pins, minus its true position."""
    others = np.arange(len(points_mm)) != pin
    backwards = RBFInterpolator(points_px[others], points_mm[others], kernel="cubic")
    return np.asarray(backwards(points_px[pin : pin + 1])[0] - points_mm[pin])

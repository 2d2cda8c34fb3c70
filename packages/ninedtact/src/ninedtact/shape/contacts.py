"""The contacts of one reading: connected places at which something touches, each with its shape and its share of the wrench.

`Reading.contacts` has them; `tracking.ContactTracker` gives a contact the same number from image to image.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from ninedtact.quantities import HeightMap, Traction, WrenchEstimate, centred_axis_mm

_LEAST_AREA_MM2 = 0.3
"""Area of the smallest contact."""
_CUT_ERROR = 0.03
"""Error of the share of each contact, over the whole force: tractions of neighbours are blurred into each other."""


@dataclass(frozen=True)
class ContactPatch:
    """One connected contact."""

    centre_mm: Float[Array, "2"]
    """Mean of its area, x and y on the skin."""
    area_mm2: float
    """Area on the plane of the untouched skin."""
    outline_mm: Float[Array, "n 2"]
    """Closed polygon around it, without its holes."""
    orientation_rad: float
    """Angle of its long axis from x, −π/2 to π/2; has no meaning where `elongation` is about one."""
    elongation: float
    """Ratio of its extents along and across the long axis, at least one."""
    convexity: float
    """Share of its convex hull that the outline encloses; one for a convex contact."""
    force: WrenchEstimate | None = None
    """Its share of the wrench about the centre of the skin, with its error; None where the reading has no tractions."""
    number: int = 0
    """The same in every image in which the contact is followed, from 1; 0 in a single reading."""


def find_contacts(
    height: HeightMap, contact: Bool[Array, "rows cols"], force: WrenchEstimate | None
) -> tuple[ContactPatch, ...]:
    """Return the connected parts of the pixels in contact, the largest first.

    The shares of the wrench add up to the whole: every place of the traction belongs to the nearest contact.
    """
    patches = tuple(_measure_patch(height, part) for part in _find_parts(height, contact))
    if not patches or force is None or force.traction is None:
        return patches
    if len(patches) == 1:
        return (replace(patches[0], force=force),)
    shares = _cut_force(force, force.traction, patches)
    return tuple(replace(patch, force=share) for patch, share in zip(patches, shares, strict=True))


@dataclass(frozen=True)
class _Part:
    """One connected part of the pixels that touch."""

    mask: UInt8[Array, "part_rows part_cols"]
    """One on the part, zero elsewhere in the rectangle around it."""
    row: int
    col: int
    """First row and column of the rectangle."""
    points_mm: Float[Array, "n 3"]
    """The skin at its pixels."""
    area_mm2: float


def _find_parts(height: HeightMap, contact: Bool[Array, "rows cols"]) -> list[_Part]:
    """Return the connected parts that are large enough, the largest first."""
    left, top, width, high = cv2.boundingRect(contact.view(np.uint8))
    if not width:  # OpenCV ends the process at an empty image
        return []
    touched = contact[top : top + high, left : left + width].view(np.uint8)
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(touched, connectivity=8, ltype=cv2.CV_16U)
    parts = []
    for label in range(1, count):
        col, row, width, high, pixels = boxes[label].tolist()
        if pixels * height.mm_per_px**2 >= _LEAST_AREA_MM2:
            mask = (labels[row : row + high, col : col + width] == label).view(np.uint8)
            rows, cols = np.nonzero(mask)
            row, col = row + top, col + left
            points_mm = height.points_at(rows + row, cols + col)
            scale = 1 + points_mm[:, 2] / height.camera_distance_mm
            parts.append(_Part(mask, row, col, points_mm, float(scale @ scale) * height.mm_per_px**2))
    return sorted(parts, key=lambda part: -part.area_mm2)


def _measure_patch(height: HeightMap, part: _Part) -> ContactPatch:
    """Return a contact with its shape."""
    centre_mm = part.points_mm[:, :2].mean(axis=0)
    from_centre_mm = part.points_mm[:, :2] - centre_mm
    extents, axes = np.linalg.eigh(from_centre_mm.T @ from_centre_mm)
    angle = float(np.arctan2(axes[1, 1], axes[0, 1]))
    contours, _ = cv2.findContours(part.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)[:, 0]
    return ContactPatch(
        centre_mm,
        part.area_mm2,
        height.points_at(outline[:, 1] + part.row, outline[:, 0] + part.col)[:, :2],
        (angle + np.pi / 2) % np.pi - np.pi / 2,
        float(np.sqrt(extents[1] / max(extents[0], 1e-12))),
        cv2.contourArea(outline) / max(cv2.contourArea(cv2.convexHull(outline)), 1e-12),
    )


def _cut_force(whole: WrenchEstimate, traction: Traction, patches: tuple[ContactPatch, ...]) -> list[WrenchEstimate]:
    """Return the share of every contact; every cell of the traction belongs to the nearest one.

    The variance of a share is the same part of the whole variance as its load is of the whole load, and the error of the cut.
    """
    rows, cols = traction.pressure_mpa.shape
    x_mm, y_mm = (centred_axis_mm(side, traction.mm_per_px).astype(float) for side in (cols, rows))
    cells_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    distances = [np.asarray(cKDTree(patch.outline_mm).query(cells_mm)[0]) for patch in patches]
    owner = np.argmin(distances, axis=0).reshape(rows, cols)
    wrenches = [
        replace(traction, pressure_mpa=traction.pressure_mpa * own, shear_mpa=traction.shear_mpa * own).wrench()
        for own in (owner == number for number in range(len(patches)))
    ]
    loads_n = np.array([max(-wrench.force_n[2], 0.0) for wrench in wrenches])
    total_n = float(loads_n.sum())
    cut = np.diag([(_CUT_ERROR * total_n) ** 2] * 3 + [0.0] * 3)
    return [
        replace(whole, wrench=wrench, covariance=load_n / max(total_n, 1e-12) * whole.covariance + cut, traction=None)
        for wrench, load_n in zip(wrenches, loads_n.tolist(), strict=True)
    ]

"""The contacts of one reading: connected places at which something touches, each with its shape and its share of the wrench.

`find_contacts` returns those of one reading. `ContactFollower` gives a contact the same number from image to image.
"""

from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from ninedtact.quantities import HeightMap, Traction, WrenchEstimate, centred_axis_mm
from ninedtact.reading import Reading

_LEAST_AREA_MM2 = 0.3
"""Area of the smallest contact."""
_CUT_ERROR = 0.03
"""Error of the share of each contact, over the whole force: tractions of neighbours are blurred into each other."""
_REACH_MM = 1.0
"""Distance that a contact may move from one image to the next, beyond its own radius."""


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


def find_contacts(reading: Reading) -> tuple[ContactPatch, ...]:
    """Return the contacts of a reading, the largest first; none where nothing touches.

    The shares of the wrench add up to the wrench of the reading: every place of the traction belongs to the nearest contact.
    """
    if reading.force is not None and not reading.force.touching:
        return ()
    parts = _find_parts(reading.height, reading.contact)
    patches = tuple(_measure_patch(reading.height, part) for part in parts)
    if not patches or reading.force is None or reading.force.traction is None:
        return patches
    if len(patches) == 1:
        return (replace(patches[0], force=reading.force),)
    shares = _cut_force(reading.force, reading.force.traction, patches)
    return tuple(replace(patch, force=share) for patch, share in zip(patches, shares, strict=True))


@dataclass(frozen=True)
class _Part:
    """One connected part of the pixels that touch."""

    mask: UInt8[Array, "part_rows part_cols"]
    """One on the part, zero elsewhere in the rectangle around it."""
    row: int
    col: int
    """First row and column of the rectangle."""
    area_mm2: float


def _find_parts(height: HeightMap, contact: Bool[Array, "rows cols"]) -> list[_Part]:
    """Return the connected parts that are large enough, the largest first."""
    count, labels, boxes, _ = cv2.connectedComponentsWithStats(contact.view(np.uint8), connectivity=8)
    parts = []
    for label in range(1, count):
        col, row, width, high, pixels = boxes[label].tolist()
        if pixels * height.mm_per_px**2 >= _LEAST_AREA_MM2:
            box = np.s_[row : row + high, col : col + width]
            mask = (labels[box] == label).astype(np.uint8)
            scale = 1 + height.z_mm[box][mask > 0].astype(float) / height.camera_distance_mm
            parts.append(_Part(mask, row, col, float((scale**2).sum()) * height.mm_per_px**2))
    return sorted(parts, key=lambda part: -part.area_mm2)


def _measure_patch(height: HeightMap, part: _Part) -> ContactPatch:
    """Return a contact with its shape."""
    rows, cols = np.nonzero(part.mask)
    points_mm = _on_skin(height, rows + part.row, cols + part.col)
    extents, axes = np.linalg.eigh(np.cov(points_mm.T))
    angle = float(np.arctan2(axes[1, 1], axes[0, 1]))
    contours, _ = cv2.findContours(part.mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outline = max(contours, key=len)[:, 0]
    return ContactPatch(
        points_mm.mean(axis=0),
        part.area_mm2,
        _on_skin(height, outline[:, 1] + part.row, outline[:, 0] + part.col),
        (angle + np.pi / 2) % np.pi - np.pi / 2,
        float(np.sqrt(extents[1] / max(extents[0], 1e-12))),
        cv2.contourArea(outline) / max(cv2.contourArea(cv2.convexHull(outline)), 1e-12),
    )


def _on_skin(height: HeightMap, rows: Int[Array, " n"], cols: Int[Array, " n"]) -> Float[Array, "n 2"]:
    """Return x and y of the skin that pixels see."""
    x_axis, y_axis = height.axes_mm
    scale = 1 + height.z_mm[rows, cols].astype(float) / height.camera_distance_mm
    return np.column_stack([x_axis[cols] * scale, y_axis[rows] * scale])


def _cut_force(whole: WrenchEstimate, traction: Traction, patches: tuple[ContactPatch, ...]) -> list[WrenchEstimate]:
    """Return the share of every contact; every cell of the traction belongs to the nearest one.

    The variance of a share is the same part of the whole variance as its load is of the whole load, and the error of the cut.
    """
    rows, cols = traction.pressure_mpa.shape
    x_mm, y_mm = (centred_axis_mm(side, traction.mm_per_px).astype(float) for side in (cols, rows))
    cells_mm = np.stack(np.meshgrid(x_mm, y_mm), axis=-1).reshape(-1, 2)
    distances = [np.asarray(cKDTree(patch.outline_mm).query(cells_mm)[0]) for patch in patches]
    owner = np.argmin(distances, axis=0).reshape(rows, cols)
    wrenches = [_within(traction, owner == number).wrench() for number in range(len(patches))]
    loads_n = np.array([max(-wrench.force_n[2], 0.0) for wrench in wrenches])
    total_n = float(loads_n.sum())
    cut = np.diag([(_CUT_ERROR * total_n) ** 2] * 3 + [0.0] * 3)
    return [
        replace(whole, wrench=wrench, covariance=load_n / max(total_n, 1e-12) * whole.covariance + cut, traction=None)
        for wrench, load_n in zip(wrenches, loads_n.tolist(), strict=True)
    ]


def _within(traction: Traction, mask: Bool[Array, "rows cols"]) -> Traction:
    """Return the traction where a mask is true, zero elsewhere."""
    return replace(traction, pressure_mpa=traction.pressure_mpa * mask, shear_mpa=traction.shear_mpa * mask)


@dataclass
class ContactFollower:
    """Numbers the contacts of a stream so that one keeps its number while it is near where it was in the image before."""

    _last: tuple[ContactPatch, ...] = field(default=(), init=False, repr=False)
    _newest: int = field(default=0, init=False, repr=False)

    def update(self, found: tuple[ContactPatch, ...]) -> tuple[ContactPatch, ...]:
        """Return the contacts of the next image with their numbers."""
        pairs = sorted(
            (float(np.linalg.norm(now.centre_mm - before.centre_mm)), new, old)
            for new, now in enumerate(found)
            for old, before in enumerate(self._last)
        )
        numbers = dict[int, int]()
        taken = set[int]()
        for distance, new, old in pairs:
            reach = _REACH_MM + float(np.sqrt(max(found[new].area_mm2, self._last[old].area_mm2) / np.pi))
            if new not in numbers and old not in taken and distance < reach:
                numbers[new] = self._last[old].number
                taken.add(old)
        numbered = []
        for new, contact in enumerate(found):
            if new not in numbers:
                self._newest += 1
                numbers[new] = self._newest
            numbered.append(replace(contact, number=numbers[new]))
        self._last = tuple(numbered)
        return self._last

"""The images of a video or folder that show no contact, chosen by what changes in it."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float32
from numpy import ndarray as Array

from ninedtact.capture.frame_source import FrameSource, SourceEnded
from ninedtact.errors import CameraError, FileFormatError, InputError
from ninedtact.quantities import Frame
from ninedtact.shape.calibrated_shape import MIN_LIT_GREY_LEVEL, REFERENCE_FRAMES
from ninedtact.shape.lens_and_rectification import to_grey_float

_CELLS = 24, 18
"""Columns and rows to which images are reduced to be compared."""
_STEADY_FRAMES, _ENOUGH_FRAMES = 3, 5
"""Images from which the noise of a sequence is known; and that are enough for a reference, so that more can be done without."""
_STEADY_FACTOR, _LEAST_CHANGE = 2.0, 5e-4
"""Root mean square change of an image from the mean of those before, over the largest of the first images, up to which nothing has
happened; and the change, relative to the brightness, that is assumed of these at least. On simulated sensors ten images without
contact differ by up to this factor, also where they are compressed."""
_MOST_CHANGE = 0.008
"""The same that no compression makes."""
_ALIKE_CHANGE = 0.01
"""Largest relative change of a cell up to which the beginning and the end of a sequence show the same."""
_MORE_DETAIL = 1.01
"""Detail of the beginning over that of the end from which the beginning shows a contact: it is more often free than the end."""
_DETAIL_CELLS = 2.0
"""Standard deviation, in cells, of the smoothing that keeps the pattern of the light and removes the edges of a contact."""
_DARK = 0.5
"""Part of the usual brightness up to which a cell shows a border: contacts do not darken so much."""


@dataclass(frozen=True)
class ReferenceFrames:
    """The images of a sequence that are taken to show no contact, and the light of all."""

    frames: tuple[Frame, ...]
    brightness: Float32[Array, "n cell_rows cell_cols"]
    """That of every image of the sequence on cells, up to where the file is damaged."""


def read_reference_frames(source: FrameSource, chosen: tuple[int, int] | None = None) -> ReferenceFrames:
    """Return the reference images of a video or folder, which is read once for them.

    chosen: the first and the end of their numbers, counted from 0; None takes the first ones up to the first change, or the last
    ones where the first show a contact. Raises `InputError` where there are none, and what the source raises before its first
    image.
    """
    first, last = list[Frame](), deque[Frame](maxlen=REFERENCE_FRAMES)
    start, end = (0, REFERENCE_FRAMES) if chosen is None else chosen
    brightness = list[Float32[Array, "cell_rows cell_cols"]]()
    with source:
        try:
            while True:
                frame = source.read()
                if start <= len(brightness) < end:
                    first.append(frame)
                last.append(frame)
                brightness.append(brightness_on_cells([frame]))
        except (SourceEnded, CameraError, FileFormatError):
            if not brightness:
                raise
    if chosen is None:
        return ReferenceFrames(choose_reference_frames(first, list(last)), np.array(brightness))
    if len(first) < end - start:
        raise InputError(
            expected=f"reference images {start} to {end - 1} of {source.name}",
            got=f"{len(brightness)} images",
            remedy="name earlier ones",
        )
    return ReferenceFrames(tuple(first), np.array(brightness))


def choose_reference_frames(first: Sequence[Frame], last: Sequence[Frame]) -> tuple[Frame, ...]:
    """Return the images at the beginning of a sequence until something changes, or those at its end where the beginning shows a
    contact."""
    beginning, ending = _steady(first), _steady(last[::-1])
    first_cells, last_cells = brightness_on_cells(beginning), brightness_on_cells(ending)
    skin = _shows_skin(first_cells) & _shows_skin(last_cells)
    change = np.abs(_relative_change(last_cells, first_cells)[skin])
    is_alike = float(change.max(initial=0.0)) < _ALIKE_CHANGE
    is_first = is_alike or _fine_detail(first_cells, skin) < _MORE_DETAIL * _fine_detail(last_cells, skin)
    return beginning if is_first else ending[::-1]


def _steady(frames: Sequence[Frame]) -> tuple[Frame, ...]:
    """Return the first frames, up to the one that differs from those before by more than these do among themselves; where they are
    enough, without the one before it, in which the change may have begun."""
    cells, noise = [brightness_on_cells([frame]) for frame in frames], _LEAST_CHANGE
    for count in range(1, len(frames)):
        change = _relative_change(cells[count], np.mean(cells[:count], axis=0))
        size = float(np.sqrt(np.mean(change**2) / (1 + 1 / count)))  # the mean before has noise of its own
        if size > (_STEADY_FACTOR * noise if count >= _STEADY_FRAMES else _MOST_CHANGE):
            return tuple(frames[: count - 1 if count > _ENOUGH_FRAMES else count])
        noise = max(noise, size if count < _STEADY_FRAMES else noise)
    return tuple(frames)


def brightness_on_cells(frames: Sequence[Frame]) -> Float32[Array, "cell_rows cell_cols"]:
    """Return the mean brightness of images on cells."""
    return np.asarray(
        cv2.GaussianBlur(cv2.resize(mean_grey(frames), _CELLS, interpolation=cv2.INTER_AREA), (0, 0), 0.7)
    )


def _shows_skin(cells: Float32[Array, "cell_rows cell_cols"]) -> Bool[Array, "cell_rows cell_cols"]:
    """Return which cells, and all of their neighbours, show no black border."""
    is_lit = cells > MIN_LIT_GREY_LEVEL
    is_bright = is_lit & (cells > _DARK * np.median(cells[is_lit] if is_lit.any() else 0.0))
    return cv2.erode(is_bright.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def _fine_detail(cells: Float32[Array, "cell_rows cell_cols"], skin: Bool[Array, "cell_rows cell_cols"]) -> float:
    """Return the variance of log brightness that is finer than the pattern of the light; a contact adds to it."""
    level, weight = np.log(np.maximum(cells, 1.0)), skin.astype(np.float32)
    wide, share = (cv2.GaussianBlur(one, (0, 0), _DETAIL_CELLS) for one in (level * weight, weight))
    return float(np.var((level - wide / np.maximum(share, 1e-6))[skin])) if skin.any() else 0.0


def mean_grey(frames: Sequence[Frame]) -> Float32[Array, "rows cols"]:
    """Return the mean grey levels of images."""
    return np.asarray(np.mean([to_grey_float(frame.image) for frame in frames], axis=0), np.float32)


def _relative_change(
    now: Float32[Array, "cell_rows cell_cols"], before: Float32[Array, "cell_rows cell_cols"]
) -> Float32[Array, "cell_rows cell_cols"]:
    """Return the change of brightness but for that of the whole; zero where it is dark, as in black borders."""
    is_lit = before > MIN_LIT_GREY_LEVEL
    ratio = now / np.maximum(before, 1)
    level = max(float(np.median(ratio[is_lit])), 1e-3) if is_lit.any() else 1.0
    return np.where(is_lit, ratio / level - 1, 0).astype(np.float32)

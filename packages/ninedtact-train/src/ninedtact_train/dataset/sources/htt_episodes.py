"""Force episodes of the Heterogeneous Tactile Transformer (HTT): one .npz for each press of a probe on a 9DTact.

`tactile_img` (T, 224, 224, 3) 8-bit RGB, `ref_frame` (224, 224, 3) in 0 to 255 or 0 to 1, `6d_force` (T, 6), `ref_force` (6). The
label is `6d_force` − `ref_force`; `probe` and `mode` say what pressed and how (docs/references.md). Signs, axes and the origin of
the torques are not documented: they are taken as they are unless stated, and the checks list pairs where pressing is positive.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, Shaped, UInt8
from numpy import ndarray as Array

from ninedtact.capture.strict_image_reading import encode_png
from ninedtact.checked_reading import NPY_READ_ERRORS
from ninedtact.errors import FileFormatError
from ninedtact_train.dataset.fault_report import PairFault, PairFinding
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage, SourceItem
from ninedtact_train.dataset.sources.source import Source, find_files_with_suffix

EPISODE_SUFFIX = ".npz"
_IMAGES, _FORCES, _REFERENCE, _OLDER_REFERENCE, _TARE = "tactile_img", "6d_force", "ref_frame", "bg_frame", "ref_force"
_ARRAYS = (_IMAGES, _FORCES, _REFERENCE, _OLDER_REFERENCE, _TARE, "probe")
_LIGHT_BELOW_N = 0.3
_USUAL_ORIGIN_MM = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class _Episode:
    images: UInt8[Array, "steps rows cols 3"]
    """RGB."""
    reference: UInt8[Array, "rows cols"]
    """The image without contact, grey."""
    forces: Float64[Array, "steps 6"]
    """The measured wrenches minus their tare."""
    probe: str | None
    """Name of the probe that pressed; None where the file does not say it."""


def _read_episode(path: Path) -> _Episode:
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in _ARRAYS if name in stored.files}
            names = stored.files
    except NPY_READ_ERRORS as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise _damage(path, "an .npz archive of plain numbers", reason) from error
    if not (_IMAGES in arrays and _FORCES in arrays and (_REFERENCE in arrays or _OLDER_REFERENCE in arrays)):
        raise _damage(path, f"the arrays {_IMAGES}, {_REFERENCE} and {_FORCES}", ", ".join(names) or "none")
    images, forces, tare = arrays[_IMAGES], arrays[_FORCES], arrays.get(_TARE, np.zeros(6))
    reference = arrays[_REFERENCE if _REFERENCE in arrays else _OLDER_REFERENCE]
    are_images = images.ndim == 4 and images.shape[3] == 3 and 0 not in images.shape[1:3] and images.dtype == np.uint8
    is_rgb = reference.ndim == 3 and reference.shape[2] == 3 and reference.size > 0
    for expected, array, is_right in (
        (f"{_IMAGES} as 8-bit images (T, rows, cols, 3)", images, are_images),
        (f"{_REFERENCE} as one RGB image", reference, is_rgb and _is_numeric(reference)),
        (f"{_FORCES} of shape {(len(images), 6)}", forces, forces.shape == (len(images), 6) and _is_numeric(forces)),
        (f"{_TARE} of six numbers", tare, tare.shape == (6,) and _is_numeric(tare)),
    ):
        if not is_right:
            raise _damage(path, expected, f"{array.dtype} of shape {array.shape}")
    return _Episode(images, _to_grey_levels(reference), forces.astype(float) - tare, _probe_name(arrays))


def _is_numeric(array: Shaped[Array, "..."]) -> bool:
    return array.dtype.kind in "iuf"


def _to_grey_levels(image: Shaped[Array, "rows cols 3"]) -> UInt8[Array, "rows cols"]:
    """Return an RGB image of any numeric type in grey; floating-point numbers are levels or parts of 255."""
    if image.dtype.kind == "f":
        scale = 255.0 if np.nanmax(image) <= 1.0 else 1.0
        image = np.rint(np.nan_to_num(image) * scale)
    return _rgb_to_grey(np.clip(image, 0, 255).astype(np.uint8))


def _probe_name(arrays: Mapping[str, Array]) -> str | None:
    number = arrays.get("probe")
    if number is None or number.size != 1 or number.dtype.kind not in "iu":
        return None
    return f"probe_{int(number.ravel()[0])}"


def _damage(path: Path, expected: str, got: str) -> FileFormatError:
    return FileFormatError(expected=f"{expected} in {path}", got=got, remedy="copy the file again")


def _rgb_to_grey(image: UInt8[Array, "rows cols 3"]) -> UInt8[Array, "rows cols"]:
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(frozen=True)
class TactileTransformerSource(Source):
    """A source of force episodes of the Heterogeneous Tactile Transformer: one, or a folder of them."""

    description = "force episodes of the Heterogeneous Tactile Transformer"
    warnings = (
        "The transformer's episodes are under CC BY-NC. The origin of their torques, their axes and the scale of their images are "
        "not documented: they were taken as they are unless stated.",
    )

    def files(self) -> list[Path]:
        """Return the .npz files of all episodes."""
        return find_files_with_suffix(self.path, EPISODE_SUFFIX)

    def items(self, part: Path) -> Iterator[SourceItem]:
        """Yield the reference image of an episode and every image with its wrench."""
        name, sensor = self.name_of(part), self.conventions.sensor_name or self.name
        try:
            episode = _read_episode(part)
        except FileFormatError as error:
            yield PairFinding(PairFault.UNREADABLE, name, str(error))
            return
        yield ReferenceImage(name, encode_png(episode.reference), sensor)
        probe = episode.probe or name.removeprefix(f"{self.name}/").rpartition("/")[0] or part.stem
        for step, (image, measured) in enumerate(zip(episode.images, episode.forces, strict=True)):
            wrench = self.conventions.wrench_about_skin(measured, _USUAL_ORIGIN_MM)
            yield DatasetRow(
                id=f"{name}/{step:05d}",
                image=encode_png(_rgb_to_grey(image)),
                reference_id=name,
                wrench=wrench,
                object=f"{self.name}/{probe}",
                contact_id=name,
                step=step,
                time_ns=None,
                sensor=sensor,
                kind="light_touch" if abs(wrench[2]) < _LIGHT_BELOW_N else "stream",
                source=self.name,
                mm_per_px=self.conventions.mm_per_px,
            )

"""The original 9DTact project's `Dataset` folder: `image/` or `mixed_image/`, and `wrench/`, with a folder for each object in each.

    Dataset/image/<object>/<n>.png           rectified, BGR
    Dataset/mixed_image/<object>/<n>.png     B the reference, G 3·brighter, R 3·darker
    Dataset/wrench/<object>/<n>.npy          six numbers, N and N·m; <n>_norm.npy the same, 0 to 1 over its ranges

The reference image is stored in channel B alone. The folder does not distinguish contacts: all pairs of an object count as one,
so that a split by contact keeps them together. Torques are about the force/torque sensor, 35 mm below the skin
(docs/references.md).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path

import numpy as np
from jaxtyping import Float64, UInt8
from numpy import ndarray as Array

from ninedtact.capture.frame_source import natural_sort_key
from ninedtact.capture.strict_image_reading import IMAGE_SUFFIXES, encode_png, read_image
from ninedtact.checked_reading import NPY_READ_ERRORS
from ninedtact.design import ForceTorqueMount
from ninedtact.errors import FileFormatError, InputError, NinedtactError
from ninedtact.force.brightness_channels import NotAMixedImage, deformation_from_mixed_image, to_whole_grey_levels
from ninedtact_train.collecting.training_pair_rule import wrench_limits
from ninedtact_train.dataset.fault_report import PairFault, PairFinding
from ninedtact_train.dataset.schema import DatasetRow, ReferenceImage, SourceItem
from ninedtact_train.dataset.sources.source import Source

_IMAGE, _MIXED, _WRENCH = "image", "mixed_image", "wrench"
_NORM_SUFFIX = "_norm"
_PAIRS_PER_PART = 500
_USUAL_ORIGIN_MM = ForceTorqueMount().origin_mm
_NORM_TOLERANCE = 1e-5

_GreyImage = UInt8[Array, "rows cols"]
_Faults = list[tuple[PairFault, str]]


def find_original_dataset(path: Path) -> Path | None:
    """Return the folder that holds wrenches and images: this one, or the `Dataset` in it; None if neither does."""
    for folder in (path, path / "Dataset"):
        if (folder / _WRENCH).is_dir() and ((folder / _IMAGE).is_dir() or (folder / _MIXED).is_dir()):
            return folder
    return None


@dataclass(frozen=True)
class _PairFiles:
    """The files of one pair; those that are missing are None."""

    object: str
    stem: str
    image: Path | None = None
    mixed: Path | None = None
    wrench: Path | None = None
    norm: Path | None = None

    def read_wrench(self, faults: _Faults) -> Float64[Array, "6"]:
        """Return the wrench as the force/torque sensor measured it, compared with its normalised copy."""
        assert self.wrench is not None
        wrench = _read_six_numbers(self.wrench)
        if self.norm is not None:
            try:
                low, high = wrench_limits()
                difference = np.abs((wrench - low) / (high - low) - _read_six_numbers(self.norm)).max()
                if np.isfinite(wrench).all() and not difference < _NORM_TOLERANCE:
                    message = f"{self.norm.name} differs by {difference:.2g} of the range"
                    faults.append((PairFault.NORM_DIFFERS, message))
            except FileFormatError as error:
                faults.append((PairFault.NORM_DIFFERS, str(error)))
        return wrench

    def read_images(self, faults: _Faults) -> tuple[_GreyImage, _GreyImage | None]:
        """Return the grey image, and the reference image if there is one; raises `FileFormatError`, `NotAMixedImage`."""
        image = None if self.image is None else _read_grey_image(self.image)
        if self.mixed is None:
            assert image is not None
            return image, None
        mixed = np.ascontiguousarray(read_image(self.mixed))
        try:
            deformation = deformation_from_mixed_image(mixed, 1.0)
        except NotAMixedImage as error:
            if image is None:
                raise
            faults.append((PairFault.MIXED_IMAGE_DIFFERS, str(error)))
            return image, mixed[..., 0].copy()
        grey = (deformation.reference - deformation.darker + deformation.brighter).astype(np.uint8)
        reference = deformation.reference.astype(np.uint8)
        if image is not None and not np.array_equal(image, grey):
            message = f"{self.mixed.name} shows another image than its image; image was taken"
            faults.append((PairFault.MIXED_IMAGE_DIFFERS, message))
        return (grey if image is None else image), reference


def _read_six_numbers(path: Path) -> Float64[Array, "6"]:
    try:
        numbers = np.load(path, allow_pickle=False)
    except NPY_READ_ERRORS as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise FileFormatError(f"expected six numbers in {path}, got: {reason}; copy the file again") from error
    if not isinstance(numbers, np.ndarray) or numbers.dtype.kind not in "iuf" or numbers.size != 6:
        got = f"{numbers.dtype} of shape {numbers.shape}" if isinstance(numbers, np.ndarray) else "an archive"
        raise FileFormatError(expected=f"six numbers in {path}", got=f"{got}", remedy="copy the file again")
    return numbers.astype(float).ravel()


def _read_grey_image(path: Path) -> _GreyImage:
    return to_whole_grey_levels(read_image(path), 1.0).grey.astype(np.uint8)


@dataclass(frozen=True)
class OriginalDatasetSource(Source):
    """A source of pairs in the original project's Dataset folder."""

    description = "the original project's Dataset folder"
    warnings = (
        "Torques of the original project are about its force/torque sensor, 35 mm below the skin. They were moved to the skin's "
        "centre, unless another origin was stated. Its folder does not distinguish contacts: all pairs of an object count as one.",
    )

    def statement_lines(self) -> Iterator[str]:
        """Yield what was stated about the folder."""
        yield from super().statement_lines()
        if self.conventions.reference is not None:
            yield f"images without a mixed_image have the reference image {self.conventions.reference.name}"

    def files(self) -> list[Path]:
        """Return everything in the three folders but hidden files."""
        root = self.root
        found = (path for folder in (_IMAGE, _MIXED, _WRENCH) for path in (root / folder).rglob("*"))
        return sorted(path for path in found if not _is_hidden_file(path, root) and path.is_file())

    def parts(self) -> Sequence[Sequence[_PairFiles | str]]:
        """Return parts of some hundred pairs, with objects in counting order, and one of the files that belong to no pair."""
        pairs, stray = _group_files(self.root, self.files())
        if not pairs:
            raise InputError(
                expected=f"images and wrenches as <object>/<n>.png and <object>/<n>.npy in {self.root}",
                got="none",
                remedy="copy the whole Dataset folder of the original project",
            )
        parts = [pairs[at : at + _PAIRS_PER_PART] for at in range(0, len(pairs), _PAIRS_PER_PART)]
        return [*parts, stray] if stray else parts

    def items(self, part: Sequence[_PairFiles | str]) -> Iterator[SourceItem]:
        """Yield the pairs, every reference image once before the first pair that names it, and a rejection for stray files."""
        known: set[str] = set()
        path = self.conventions.reference
        given = self._make_reference(_read_grey_image(path)) if path else None
        for one in part:
            for item in self._reject_stray(one) if isinstance(one, str) else self._read_pair(one, given):
                if isinstance(item, ReferenceImage):
                    if item.reference_id in known:
                        continue
                    known.add(item.reference_id)
                yield item

    def _reject_stray(self, name: str) -> Iterator[PairFinding]:
        message = f"{name} is neither <object>/<n>.png nor <object>/<n>.npy"
        yield PairFinding(PairFault.UNREADABLE, f"{self.name}/{name}", message)

    def _read_pair(self, pair: _PairFiles, given: ReferenceImage | None) -> Iterator[SourceItem]:
        """Yield the reference image and the row, or why there is no row; given: a reference image that a person named."""
        name, folder, stem = f"{self.name}/{pair.object}/{pair.stem}", pair.object, pair.stem
        if pair.wrench is None:
            message = f"expected wrench/{folder}/{stem}.npy, got none{' (only its _norm.npy)' if pair.norm else ''}"
            yield PairFinding(PairFault.MISSING_WRENCH, name, message)
            return
        if pair.image is None and pair.mixed is None:
            message = f"expected {stem}.png in image/{folder} or mixed_image/{folder}, got none"
            yield PairFinding(PairFault.MISSING_IMAGE, name, message)
            return
        faults: _Faults = []
        try:
            measured = pair.read_wrench(faults)
            grey, reference_grey = pair.read_images(faults)
        except NinedtactError as error:
            yield PairFinding(PairFault.UNREADABLE, name, str(error))
            return
        reference = given if reference_grey is None else self._make_reference(reference_grey)
        if reference:
            yield reference
        yield DatasetRow(
            id=name,
            image=encode_png(grey),
            reference_id=reference.reference_id if reference else None,
            wrench=self.conventions.wrench_about_skin(measured, _USUAL_ORIGIN_MM),
            object=f"{self.name}/{folder}",
            contact_id=f"{self.name}/{folder}",
            step=int(stem) if stem.isdecimal() and len(stem) < 10 else 0,
            time_ns=None,
            sensor=self._sensor,
            kind="rule",
            source=self.name,
            mm_per_px=self.conventions.mm_per_px,
            faults=tuple(faults),
        )

    def _make_reference(self, grey: _GreyImage) -> ReferenceImage:
        """Return a reference image whose id is a digest of its pixels, so that equal ones are stored once."""
        digest = blake2b(grey.tobytes(), digest_size=6).hexdigest()
        return ReferenceImage(f"{self.name}/{digest}", encode_png(grey), self._sensor)

    @property
    def _sensor(self) -> str:
        return self.conventions.sensor_name or self.name

    @property
    def root(self) -> Path:
        """The folder that contains the three folders."""
        return find_original_dataset(self.path) or self.path


def _is_hidden_file(path: Path, root: Path) -> bool:
    return any(part.startswith(".") or part == "Thumbs.db" for part in path.relative_to(root).parts)


def _group_files(root: Path, files: list[Path]) -> tuple[list[_PairFiles], list[str]]:
    """Return pairs in the order of object and number, and the names of files that belong to none."""
    pairs: dict[tuple[str, str], dict[str, Path]] = {}
    stray: list[str] = []
    for file in files:
        kind, *middle, _ = file.relative_to(root).parts
        role, stem = _file_role(kind, file)
        if role is None or len(middle) != 1 or role in pairs.get((middle[0], stem), {}):
            stray.append(file.relative_to(root).as_posix())
        else:
            pairs.setdefault((middle[0], stem), {})[role] = file
    order = sorted(pairs, key=lambda key: (natural_sort_key(Path(key[0])), natural_sort_key(Path(key[1])), key))
    return [_PairFiles(object_name, stem, **pairs[object_name, stem]) for object_name, stem in order], stray


def _file_role(kind: str, file: Path) -> tuple[str | None, str]:
    """Return the role of a file in its pair, None if it has none, and the name of the pair."""
    if kind == _WRENCH and file.suffix.lower() == ".npy":
        is_norm = file.stem.endswith(_NORM_SUFFIX)
        return ("norm", file.stem.removesuffix(_NORM_SUFFIX)) if is_norm else ("wrench", file.stem)
    if kind in (_IMAGE, _MIXED) and file.suffix.lower() in IMAGE_SUFFIXES:
        return ("image" if kind == _IMAGE else "mixed"), file.stem
    return None, file.stem

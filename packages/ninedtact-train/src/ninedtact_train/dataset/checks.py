"""Checks of every pair of a data set. Faults are listed and counted; pairs are left out only on request.

Darkening: the image is averaged over tiles of at least 6 x 6 pixels, and the darkest tile is compared with the median one. In
simulated data, noise alone comes to 0.5 grey levels, and 2 N to more than 0.8 with every object and sensor.
"""

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Annotated, Any

import cv2
import msgspec
import numpy as np
from jaxtyping import UInt8
from msgspec import Meta
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.force.brightness_channels import format_image_size
from ninedtact.parallel_jobs import run_jobs
from ninedtact.quantities import WRENCH_AXES, WRENCH_UNITS
from ninedtact.shape.image_plausibility import find_exposure_warning
from ninedtact_train.collecting.training_pair_rule import wrench_limits
from ninedtact_train.dataset.fault_report import UNUSABLE_FAULTS, PairFault, PairFinding, QualityReport
from ninedtact_train.dataset.folder import REFERENCES_FILE, find_pair_files
from ninedtact_train.dataset.parquet_files import (
    ReferenceImageFile,
    StoredImageUnreadable,
    decode_stored_image,
    decode_stored_wrench,
    iterate_rows,
)

_GreyImage = UInt8[Array, "rows cols"]
_Limit = Annotated[float, Meta(gt=0)]
_MOST_TILES, _TILE_PX = 40, 6
_CHECKED_COLUMNS = ("id", "image", "reference_id", "wrench", "wrench_delay_ms")


@checks_arguments
@dataclass(frozen=True)
class PairCheckSettings:
    """The limits beyond which a pair is listed."""

    max_wrench: tuple[_Limit, _Limit, _Limit, _Limit, _Limit, _Limit] = tuple(
        (2 * np.abs(wrench_limits()).max(0)).tolist()
    )
    """Largest forces (N) and torques (N·m) about the skin's centre; the default is twice what the paper collected."""
    pulling_above_n: _Limit = 0.3
    """Largest F_z, N, with which the object would pull at the skin."""
    max_delay_ms: _Limit = 20.0
    """Largest time between image and wrench."""
    pressed_n: _Limit = 2.0
    """Load from which the image must be darker than the reference image."""
    min_darkening_levels: _Limit = 0.6
    """Grey levels by which the darkest place must be darker than in the reference image under such a load."""
    zero_force_n: Annotated[float, Meta(ge=0)] = 0.05
    """Force that counts as zero."""
    max_zero_force_darkening_levels: _Limit = 6.0
    """Largest darkening in grey levels where the force is zero: with more, something touches."""


class FileCheck(msgspec.Struct):
    """The result of checking one file by itself, and what is needed to find duplicates across files."""

    ids: list[str]
    image_digests: list[str]
    """Digest of every image; empty where the image cannot be read."""
    findings: list[PairFinding]
    """Findings without the name of the file."""


def check_dataset(
    folder: Path, settings: PairCheckSettings = PairCheckSettings(), workers: int = 1, *, progress: bool = False
) -> QualityReport:
    """Check every pair of a data set in several processes; nothing is changed.

    Raises `FileFormatError`, `InputError`.
    """
    from tqdm import tqdm

    files = find_pair_files(folder)
    jobs = [(file, folder / REFERENCES_FILE, settings) for file in files]
    checks: dict[int, FileCheck] = {}
    with tqdm(unit="pair", disable=not progress) as bar:
        for number, check in run_jobs(check_pair_file, jobs, workers):
            checks[number] = check
            bar.update(len(check.ids))
    return combine_file_checks([checks[number] for number in range(len(files))], [file.name for file in files])


def combine_file_checks(checks: list[FileCheck], names: list[str], dropped: bool = False) -> QualityReport:
    """Return the report of all files, including the duplicates across them; names are those of the files."""
    findings = [
        msgspec.structs.replace(finding, file=name)
        for check, name in zip(checks, names, strict=True)
        for finding in check.findings
    ]
    findings += _find_duplicates(checks, names)
    in_rows = [finding for finding in findings if finding.row is not None]
    faulty = {(finding.file, finding.row) for finding in in_rows}
    unusable = {(finding.file, finding.row) for finding in in_rows if dropped or finding.fault in UNUSABLE_FAULTS}
    counts = dict(sorted(Counter(finding.fault.value for finding in findings).items()))
    pairs = sum(len(check.ids) for check in checks)
    return QualityReport(pairs, pairs - len(faulty), pairs - len(unusable), counts, dropped, findings)


def check_pair_file(path: Path, references: Path, settings: PairCheckSettings) -> FileCheck:
    """Check every pair of one file by itself; raises `FileFormatError`."""
    store, check = ReferenceImageFile(references), FileCheck([], [], [])
    for number, row in enumerate(iterate_rows(path, _CHECKED_COLUMNS)):
        try:
            image = decode_stored_image(row["image"])
        except StoredImageUnreadable as error:
            faults, digest = [(PairFault.UNREADABLE, str(error))], ""
        else:
            faults = list(_find_pair_faults(image, store.find(row["reference_id"]), row, settings))
            digest = blake2b(image.tobytes(), digest_size=12, salt=f"{image.shape[1]}".encode()).hexdigest()
        check.ids.append(row["id"])
        check.image_digests.append(digest)
        check.findings += [PairFinding(fault, row["id"], message, number) for fault, message in faults]
    return check


def _find_pair_faults(
    image: UInt8[Array, "_ _"], reference: UInt8[Array, "_ _"] | None, row: dict[str, Any], settings: PairCheckSettings
) -> Iterator[tuple[PairFault, str]]:
    wrench, delay_ms = decode_stored_wrench(row["wrench"]), row["wrench_delay_ms"]
    is_finite = bool(np.isfinite(wrench).all())
    if is_finite:
        yield from _find_wrench_faults(wrench, settings)
    else:
        yield PairFault.NOT_FINITE, f"the wrench is {' '.join(f'{value:.3g}' for value in wrench)}"
    if delay_ms is not None and not abs(delay_ms) <= settings.max_delay_ms:
        limit = f"more than {settings.max_delay_ms:g} ms"
        yield PairFault.UNSYNCHRONISED, f"{delay_ms:.1f} ms from image to wrench, {limit}"
    if reference is None:
        yield PairFault.NO_REFERENCE, f"no readable reference image has the id {row['reference_id']!r}"
    elif reference.shape != image.shape:
        yield (
            PairFault.WRONG_SIZE,
            f"{format_image_size(image)}, and its reference image {format_image_size(reference)}",
        )
    elif is_finite:
        yield from _find_contradictions(image, reference, wrench, settings)


def _find_wrench_faults(wrench: Array, settings: PairCheckSettings) -> Iterator[tuple[PairFault, str]]:
    beyond = np.abs(wrench) > np.array(settings.max_wrench)
    if beyond.any():
        axis = int(np.argmax(beyond))
        unit = WRENCH_UNITS[axis]
        limit = f"beyond {settings.max_wrench[axis]:g} {unit}"
        yield PairFault.OUT_OF_RANGE, f"{WRENCH_AXES[axis]} of {wrench[axis]:.4g} {unit}, {limit}"
    if wrench[2] > settings.pulling_above_n:
        yield PairFault.PULLING, f"Fz of {wrench[2]:+.3g} N; pressing is below zero"


def _find_contradictions(
    image: _GreyImage, reference: _GreyImage, wrench: Array, settings: PairCheckSettings
) -> Iterator[tuple[PairFault, str]]:
    """Yield a fault where the image cannot be a press, and where image and wrench contradict each other."""
    light = find_exposure_warning(image, reference)
    if light is not None:
        yield PairFault.NO_LIGHT, str(light)
        return
    levels = local_darkening_levels(image, reference)
    if wrench[2] <= -settings.pressed_n and levels < settings.min_darkening_levels:
        yield PairFault.NO_DARKENING, f"Fz of {wrench[2]:.3g} N, and {levels:.2g} grey levels of darkening"
    is_zero_force = np.abs(wrench[:3]).max() <= settings.zero_force_n
    if is_zero_force and levels > settings.max_zero_force_darkening_levels:
        yield PairFault.NO_MEASURED_FORCE, f"zero force, and {levels:.2g} grey levels of darkening"


def local_darkening_levels(image: _GreyImage, reference: _GreyImage) -> float:
    """Return by how many grey levels the darkest tile is darker than the median tile, relative to the reference image."""
    change = np.subtract(reference, image, dtype=np.float32)
    grid = tuple(max(1, min(_MOST_TILES, side // _TILE_PX)) for side in change.shape[::-1])
    tiles = cv2.resize(change, grid, interpolation=cv2.INTER_AREA)
    return float(tiles.max() - np.median(tiles))


def _find_duplicates(checks: Iterable[FileCheck], files: Iterable[str]) -> Iterator[PairFinding]:
    id_places: dict[str, str] = {}
    image_ids: dict[str, str] = {}
    for check, file in zip(checks, files, strict=True):
        for number, (name, digest) in enumerate(zip(check.ids, check.image_digests, strict=True)):
            if name in id_places:
                yield PairFinding(PairFault.DUPLICATE_ID, name, f"{id_places[name]} has the same id", number, file)
            if digest and digest in image_ids:
                message = f"{image_ids[digest]} has the same image, pixel by pixel"
                yield PairFinding(PairFault.DUPLICATE_IMAGE, name, message, number, file)
            id_places.setdefault(name, f"row {number} of {file}")
            image_ids.setdefault(digest, name)

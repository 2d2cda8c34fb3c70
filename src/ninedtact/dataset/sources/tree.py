"""The original project's `Dataset` folder: `image/` or `mixed_image/`, and `wrench/`, a folder for each object in each.

    Dataset/image/<object>/<n>.png           rectified, BGR
    Dataset/mixed_image/<object>/<n>.png     B the reference, G 3·brighter, R 3·darker
    Dataset/wrench/<object>/<n>.npy          six numbers, N and N·m; <n>_norm.npy the same, 0 to 1 over its ranges

No reference image is stored but in channel B. Contacts are not told apart: all pairs of an object count as one, so
that splits by contact keep them together. Torques are about the force/torque sensor, 35 mm below the skin
(docs/references.md).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from ninedtact.capture.image_and_video_files import IMAGE_SUFFIXES, natural_sort_key
from ninedtact.dataset.rows import Fault, Item, LeftOut, UntouchedImage
from ninedtact.dataset.sources.pair_files import PairFiles, reference_in
from ninedtact.dataset.sources.source import Part, Source, SourceUnknown, Statements
from ninedtact.simulation.simulated_sources import FORCE_TORQUE_BELOW_SKIN_MM

IMAGE, MIXED, WRENCH = "image", "mixed_image", "wrench"
NORM = "_norm"
PAIRS_PER_PART = 500
USUAL_ORIGIN_MM = (0.0, 0.0, -FORCE_TORQUE_BELOW_SKIN_MM)


def tree_in(path: Path) -> Path | None:
    """The folder that holds wrenches and images: this one, or the Dataset in it."""
    for folder in (path, path / "Dataset"):
        if (folder / WRENCH).is_dir() and ((folder / IMAGE).is_dir() or (folder / MIXED).is_dir()):
            return folder
    return None


@dataclass(frozen=True)
class TreePart(Part):
    """Some hundred pairs of it."""

    pairs: tuple[PairFiles, ...]
    statements: Statements

    def items(self) -> Iterator[Item]:
        """Its pairs, and the untouched images as they come up."""
        told: set[str] = set()
        given = reference_in(self.statements.reference, self.source) if self.statements.reference else None
        for pair in self.pairs:
            for item in pair.items(self.source, self.statements, USUAL_ORIGIN_MM, given):
                if isinstance(item, UntouchedImage) and item.id in told:
                    continue
                if isinstance(item, UntouchedImage):
                    told.add(item.id)
                yield item


@dataclass(frozen=True)
class StrayPart(Part):
    """Files that lie where pairs are, and are none."""

    files: tuple[str, ...]

    def items(self) -> Iterator[Item]:
        """Nothing but what is left out."""
        for name in self.files:
            yield LeftOut(
                Fault.UNREADABLE, f"{self.source}/{name}", f"{name} is neither <object>/<n>.png nor <object>/<n>.npy"
            )


@dataclass(frozen=True)
class TreeSource(Source):
    """The whole folder."""

    what = "the original project's Dataset folder"
    warnings = (
        "Torques of the original project are about its force/torque sensor, 35 mm below the skin. They were moved to the skin's "
        "centre, unless another origin was stated. Its tree does not tell contacts apart: all pairs of an object count as one.",
    )

    def said(self) -> Iterator[str]:
        """What a person stated."""
        return self.statements.said()

    def files(self) -> list[Path]:
        """Everything in the three folders but hidden files."""
        root = self.root
        found = (path for folder in (IMAGE, MIXED, WRENCH) for path in (root / folder).rglob("*"))
        return sorted(path for path in found if not hidden(path, root) and path.is_file())

    def parts(self) -> list[Part]:
        """Objects in counting order, cut into files."""
        pairs, stray = sorted_out(self.root, self.files())
        if not pairs:
            raise SourceUnknown(
                f"expected images and wrenches as <object>/<n>.png and <object>/<n>.npy in {self.root}, got none; copy the "
                "whole Dataset folder of the original project"
            )
        cut = range(0, len(pairs), PAIRS_PER_PART)
        parts: list[Part] = [TreePart(self.name, tuple(pairs[at : at + PAIRS_PER_PART]), self.statements) for at in cut]
        return [*parts, StrayPart(self.name, tuple(stray))] if stray else parts

    @property
    def root(self) -> Path:
        """Where the three folders are."""
        return tree_in(self.path) or self.path


def hidden(path: Path, root: Path) -> bool:
    """What file managers leave behind."""
    return any(part.startswith(".") or part == "Thumbs.db" for part in path.relative_to(root).parts)


def sorted_out(root: Path, files: list[Path]) -> tuple[list[PairFiles], list[str]]:
    """Pairs by object and number, and the names of files that belong to none."""
    pairs: dict[tuple[str, str], dict[str, Path]] = {}
    stray: list[str] = []
    for file in files:
        kind, *middle, _ = file.relative_to(root).parts
        role, stem = role_of(kind, file)
        if role is None or len(middle) != 1 or role in pairs.get((middle[0], stem), {}):
            stray.append(file.relative_to(root).as_posix())
        else:
            pairs.setdefault((middle[0], stem), {})[role] = file
    order = sorted(pairs, key=lambda key: (natural_sort_key(Path(key[0])), natural_sort_key(Path(key[1])), key))
    return [PairFiles(object_name, stem, **pairs[object_name, stem]) for object_name, stem in order], stray


def role_of(kind: str, file: Path) -> tuple[str | None, str]:
    """What a file is to its pair, and the pair's name."""
    if kind == WRENCH and file.suffix.lower() == ".npy":
        is_norm = file.stem.endswith(NORM)
        return ("norm", file.stem.removesuffix(NORM)) if is_norm else ("wrench", file.stem)
    if kind in (IMAGE, MIXED) and file.suffix.lower() in IMAGE_SUFFIXES:
        return ("image" if kind == IMAGE else "mixed"), file.stem
    return None, file.stem

"""Force episodes of the Heterogeneous Tactile Transformer: one .npz for each press of a probe on a 9DTact.

`tactile_img` (T, 224, 224, 3) 8-bit RGB, `ref_frame` (224, 224, 3) in 0 to 255 or 0 to 1, `6d_force` (T, 6), `ref_force` (6). The
label is `6d_force` − `ref_force`; `probe` and `mode` say what pressed and how (docs/references.md). Signs, axes and the torques'
origin are not documented: they are taken as they are unless stated, and the checks tell where pressing is positive.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Float64, UInt8
from numpy import ndarray as Array

from ninedtact.capture.image_and_video_files import natural_sort_key
from ninedtact.dataset.generation.pair import png
from ninedtact.dataset.rows import Fault, Item, LeftOut, Row, UntouchedImage
from ninedtact.dataset.sources.frames import Archive, archive
from ninedtact.dataset.sources.source import Part, Source, Statements, name_of
from ninedtact.errors import NinedtactError

SUFFIX = ".npz"
IMAGES, FORCES, REFERENCE, OLDER_REFERENCE, TARE = "tactile_img", "6d_force", "ref_frame", "bg_frame", "ref_force"
LIGHT_BELOW_N = 0.3
USUAL_ORIGIN_MM = (0.0, 0.0, 0.0)
STREAM = "stream"
"""The kind of its pairs: every image of an episode, no rule chose them."""


@dataclass(frozen=True)
class EpisodePart(Part):
    """One file."""

    file: Path
    name: str
    """Its path below the source, without suffix."""
    statements: Statements

    def items(self) -> Iterator[Item]:
        """The untouched skin and every image with its wrench."""
        whole_name = f"{self.source}/{self.name}"
        step = 0
        try:
            with archive(self.file) as episode:
                require_episode(episode)
                untouched = self.untouched(episode)
                yield untouched
                forces, probe = self.forces(episode), self.probe(episode)
                for step, image in enumerate(episode.frames(IMAGES)):
                    yield self.row(step, image, forces[step], probe, untouched)
        except NinedtactError as trouble:
            yield LeftOut(Fault.UNREADABLE, whole_name, f"{trouble} (read as far as image {step})")

    def row(
        self,
        step: int,
        image: UInt8[Array, "rows cols 3"],
        measured: Float64[Array, "6"],
        probe: str,
        untouched: UntouchedImage,
    ) -> Row:
        """One pair."""
        wrench = self.statements.about_skin(measured, USUAL_ORIGIN_MM)
        return Row(
            id=f"{self.source}/{self.name}/{step:05d}",
            image=png(grey_of_rgb(image)),
            reference=untouched.id,
            wrench=wrench,
            object=f"{self.source}/{probe}",
            contact=f"{self.source}/{self.name}",
            step=step,
            time_ns=None,
            sensor=untouched.sensor,
            kind="light_touch" if abs(wrench[2]) < LIGHT_BELOW_N else STREAM,
            source=self.source,
            mm_per_px=self.statements.mm_per_px,
        )

    def untouched(self, episode: Archive) -> UntouchedImage:
        """The episode's own reference; raises `EpisodeDamaged`."""
        image = episode.array(REFERENCE if episode.has(REFERENCE) else OLDER_REFERENCE)
        if image.ndim != 3 or image.shape[2] != 3 or image.dtype.kind not in "uif":
            raise episode.damaged(f"{REFERENCE} as one RGB image", f"{image.dtype} of shape {image.shape}")
        if image.dtype.kind == "f":
            scale = 255.0 if np.nanmax(image) <= 1.0 else 1.0
            image = np.rint(np.nan_to_num(image) * scale)
        grey = grey_of_rgb(np.clip(image, 0, 255).astype(np.uint8))
        return UntouchedImage(f"{self.source}/{self.name}", png(grey), self.statements.sensor or self.source)

    def forces(self, episode: Archive) -> Float64[Array, "steps 6"]:
        """What was measured, its tare taken off; raises `EpisodeDamaged`."""
        forces = episode.array(FORCES)
        images = episode.length(IMAGES)
        if forces.dtype.kind not in "iuf" or forces.shape != (images, 6):
            raise episode.damaged(f"{FORCES} of shape {(images, 6)}", f"{forces.dtype} of shape {forces.shape}")
        tare = episode.array(TARE) if episode.has(TARE) else np.zeros(6)
        if tare.dtype.kind not in "iuf" or tare.shape != (6,):
            raise episode.damaged(f"{TARE} of six numbers", f"{tare.dtype} of shape {tare.shape}")
        return forces.astype(float) - tare

    def probe(self, episode: Archive) -> str:
        """What pressed: its number, or else the folder that the episode is in."""
        if episode.has("probe"):
            number = episode.array("probe")
            if number.size == 1 and number.dtype.kind in "iu":
                return f"probe_{int(number.ravel()[0])}"
        return self.name.rpartition("/")[0] or self.name


def require_episode(episode: Archive) -> None:
    """Refuse an archive of something else; raises `EpisodeDamaged`."""
    has_reference = episode.has(REFERENCE) or episode.has(OLDER_REFERENCE)
    if not (episode.has(IMAGES) and episode.has(FORCES) and has_reference):
        raise episode.damaged(f"the arrays {IMAGES}, {REFERENCE} and {FORCES}", ", ".join(episode.names) or "none")


def grey_of_rgb(image: UInt8[Array, "rows cols 3"]) -> UInt8[Array, "rows cols"]:
    """Grey levels as everywhere else, from red, green, blue."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY))


@dataclass(frozen=True)
class HttSource(Source):
    """One episode, or a folder of them."""

    what = "force episodes of the Heterogeneous Tactile Transformer"
    warnings = (
        "The transformer's episodes are under CC BY-NC. Where the torques of their labels are about, their axes and their "
        "images' scale are not documented: they were taken as they are unless stated.",
    )

    def said(self) -> Iterator[str]:
        """What a person stated."""
        return self.statements.said()

    def files(self) -> list[Path]:
        """All .npz files."""
        if self.path.is_file():
            return [self.path]
        found = (path for path in self.path.rglob(f"*{SUFFIX}") if not path.name.startswith("."))
        return sorted(found, key=lambda path: (natural_sort_key(path.relative_to(self.path)), path))

    def parts(self) -> list[Part]:
        """One for each episode."""
        return [EpisodePart(self.name, file, name_of(file, self.root), self.statements) for file in self.files()]

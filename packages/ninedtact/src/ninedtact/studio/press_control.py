"""What a person can do with the twin: choose an object or bring one's own, and hold it to a depth or under a load.

One `TwinPressController` is shared by all viewers: they press the same twin. Each change is checked and applied to the hand of the
simulation; `revision` tells the panels of other viewers to follow.
"""

import re
from dataclasses import dataclass, replace
from math import degrees, radians
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import RLock
from typing import Any

import numpy as np

from ninedtact.errors import FileFormatError
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.simulation.hand_moved_object import HandTarget
from ninedtact.simulation.objects.catalogue import FAMILIES_BY_KIND, PRIMITIVES, indenter_from_name
from ninedtact.simulation.objects.mesh_objects import (
    MeshMisplaced,
    MeshObject,
    MeshPlacement,
    MeshUnusable,
    load_mesh_object,
)
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.simulation.trajectory import HOVER_MM

OBJECTS_BY_KIND: dict[str, tuple[str, ...]] = {"primitives": tuple(PRIMITIVES)} | {
    kind: tuple(families) for kind, families in FAMILIES_BY_KIND.items()
}
"""The names of objects that the page offers, by kind."""
OWN_KIND = "own mesh"
"""The kind of the object that a person has brought."""
MAX_DEPTH_MM, MAX_LOAD_N, MAX_TWIST_DEG, MAX_TILT_DEG, MAX_NUMBER = 1.8, 20.0, 90.0, 20.0, 99
START_DEPTH_MM = 0.6
"""Depth to which a new object is pressed, so that it does not harm a flat one."""
FIT_MM = 16.0
"""Size to which an own mesh is made to fit where its unit is not known."""
FIT = f"fit to {FIT_MM:g} mm"
"""The unit of a mesh of any size, as the page names it."""
UPLOAD_SUFFIXES = (".stl", ".obj")
MAX_UPLOAD_MB = 16
MAX_UPLOAD_TRIANGLES = 300_000


@dataclass(frozen=True)
class HandPressState:
    """Which object presses the twin by hand, and its pose, depth or load, as the page shows it."""

    kind: str = "primitives"
    family: str = "ball"
    number: int = 1
    """Number of a generated object within its family; primitives have no number."""
    by_load: bool = False
    """Whether `load_n` counts instead of `depth_mm`."""
    depth_mm: float = START_DEPTH_MM
    load_n: float = 2.0
    x_mm: float = 0.0
    y_mm: float = 0.0
    twist_deg: float = 0.0
    tilt_x_deg: float = 0.0
    tilt_y_deg: float = 0.0
    is_playing: bool = True
    """Whether the press sequence plays and the hand is empty."""

    @property
    def object_name(self) -> str:
        """The name of the object in the catalogue."""
        return self.family if self.kind in ("primitives", OWN_KIND) else f"{self.family}_{self.number:02d}"

    @property
    def target(self) -> HandTarget:
        """Where the hand holds the object."""
        turns = (radians(turn) for turn in (self.twist_deg, self.tilt_x_deg, self.tilt_y_deg))
        return HandTarget(Pose(self.x_mm, self.y_mm, self.depth_mm, *turns), self.load_n if self.by_load else None)


class TwinPressController:
    """Presses one twin for all viewers; safe to use from different threads."""

    def __init__(self, simulation: PressSequence) -> None:
        self.simulation = simulation
        x_mm, y_mm = (float(int(reach)) for reach in simulation.twin.renderer.pixel_map.reach_mm)  # the camera sees it
        tilt, twist = (-MAX_TILT_DEG, MAX_TILT_DEG), (-MAX_TWIST_DEG, MAX_TWIST_DEG)
        self.limits: dict[str, tuple[float, float]] = {
            "depth_mm": (-HOVER_MM, MAX_DEPTH_MM),
            "load_n": (0.0, MAX_LOAD_N),
            "x_mm": (-x_mm, x_mm),
            "y_mm": (-y_mm, y_mm),
            "twist_deg": twist,
            "tilt_x_deg": tilt,
            "tilt_y_deg": tilt,
        }
        """The least and the largest value of each number of `HandPressState`."""
        self._lock = RLock()
        self.state = HandPressState()
        """The object and where it is held."""
        self.revision = 0
        """Number of changes of the state until now; it is raised after the state has changed."""
        self.own_mesh: Indenter | None = None
        """The object that a person has brought last; None before."""

    def play(self) -> None:
        """Let the press sequence play."""
        with self._lock:
            self.simulation.hand.release()
            self.state = replace(self.state, is_playing=True)
            self.revision += 1

    def move(self, **changes: Any) -> None:
        """Hold the object somewhere else, within the limits; an object is taken into the hand if the sequence plays.

        changes: fields of `HandPressState`, of the pose, the depth or the load. Raises `InvalidPose`, and changes nothing, for a
        value that is not a number.
        """
        with self._lock:
            changes |= {
                name: float(np.clip(changes[name], *ends)) for name, ends in self.limits.items() if name in changes
            }
            wanted = replace(self.state, **changes)
            self.simulation.hand.aim(wanted.target)
            self.state = wanted
            if self.state.is_playing:
                self._take()
            self.revision += 1

    def choose(self, kind: str, family: str, number: int = 1) -> None:
        """Take another object into the hand, at the same place, pressed gently; raises `InputError`, `FileFormatError`."""
        with self._lock:
            wanted = replace(self.state, kind=kind, family=family, number=int(np.clip(number, 1, MAX_NUMBER)))
            wanted = replace(wanted, depth_mm=START_DEPTH_MM, by_load=False, tilt_x_deg=0.0, tilt_y_deg=0.0)
            self._find_object(wanted)
            self.state = wanted
            self.simulation.hand.aim(wanted.target)
            self._take()
            self.revision += 1

    def upload(self, name: str, content: bytes, placement: MeshPlacement = MeshPlacement()) -> str:
        """Take one's own mesh into the hand and return a sentence about it; raises `FileFormatError`."""
        mesh = read_uploaded_mesh(name, content, placement)
        with self._lock:
            self.own_mesh = mesh.relief
            self.choose(OWN_KIND, mesh.relief.name)
        size = " x ".join(f"{side:.1f}" for side in mesh.size_mm)
        cropped = "; only its middle is used" if mesh.cropped else ""
        return f"{mesh.relief.name}: {size} mm, {mesh.triangles} triangles{cropped}"

    def _take(self) -> None:
        self.simulation.hand.take(self._find_object(self.state))
        self.state = replace(self.state, is_playing=False)

    def _find_object(self, state: HandPressState) -> Indenter:
        if state.kind != OWN_KIND:
            return indenter_from_name(state.object_name)
        if self.own_mesh is None:
            raise FileFormatError(expected="a mesh of your own", got="none yet", remedy="upload an STL or OBJ file")
        return self.own_mesh


def read_uploaded_mesh(name: str, content: bytes, placement: MeshPlacement = MeshPlacement()) -> MeshObject:
    """Return the object in an uploaded file; raises `FileFormatError` with one sentence for a file that cannot be used.

    name: as the browser gives it; only its end and a harmless part of its stem are used.
    """
    suffix = Path(name).suffix.lower()
    if suffix not in UPLOAD_SUFFIXES or not 0 < len(content) <= MAX_UPLOAD_MB * 1e6:
        raise FileFormatError(
            expected=f"a file of at most {MAX_UPLOAD_MB} MB ending in {' or '.join(UPLOAD_SUFFIXES)}",
            got=f"{name[-40:]!a} of {len(content) / 1e6:.2g} MB",
            remedy="convert or simplify the mesh",
        )
    stem = re.sub(r"[^\w-]", "_", Path(name).stem)[:40] or "mesh"
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"{stem}{suffix}"
        path.write_bytes(content)
        try:
            mesh = load_mesh_object(path, placement)
        except MeshMisplaced as trouble:
            raise FileFormatError(
                f"{trouble.finding}; choose another unit, '{FIT}', or another side, and upload it again"
            ) from trouble
        except MeshUnusable as trouble:
            raise FileFormatError(str(trouble).replace(str(path), path.name)) from trouble
    if mesh.triangles > MAX_UPLOAD_TRIANGLES:
        raise FileFormatError(
            expected=f"at most {MAX_UPLOAD_TRIANGLES} triangles in {path.name}",
            got=f"{mesh.triangles}",
            remedy="simplify the mesh",
        )
    if not mesh.closed:
        raise FileFormatError(
            expected=f"a closed solid in {path.name}",
            got="edges that belong to one triangle only",
            remedy="repair the mesh",
        )
    return mesh


def pose_fields(pose: Pose) -> dict[str, float]:
    """Return the fields of `HandPressState` of an object in this pose; angles in degrees."""
    turns = {name: degrees(getattr(pose, f"{name}_rad")) for name in ("twist", "tilt_x", "tilt_y")}
    place = {name: float(getattr(pose, name)) for name in ("x_mm", "y_mm", "depth_mm")}
    return place | {f"{name}_deg": angle for name, angle in turns.items()}

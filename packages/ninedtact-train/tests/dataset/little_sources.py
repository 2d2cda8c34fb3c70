"""Small sources made by hand: the original project's folder and an episode of the transformer's, from known presses."""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from ninedtact.force.brightness_channels import encode_mixed_image
from ninedtact.quantities import Deformation

ROWS, COLS = 36, 48
LOWEST = np.array([-3, -3, -12, -0.2, -0.2, -0.05])
SPAN = np.array([6, 6, 12, 0.4, 0.4, 0.1])


def untouched(seed: int = 0, rows: int = ROWS, cols: int = COLS) -> np.ndarray:
    """Skin before it is touched, BGR with some colour in it."""
    rng = np.random.default_rng([seed, 9])
    base = np.linspace(130, 160, cols)[None, :, None] + np.array([0.0, 2.0, -2.0])
    return (base + rng.integers(0, 3, (rows, cols, 3))).astype(np.uint8)


def touched(skin: np.ndarray, load_n: float, seed: int = 0) -> np.ndarray:
    """The same skin, darker in a disc and brighter around it."""
    rows, cols = skin.shape[:2]
    rng = np.random.default_rng([seed, 7])
    y, x = np.mgrid[:rows, :cols]
    away = np.hypot(x - cols * rng.uniform(0.3, 0.7), y - rows * rng.uniform(0.3, 0.7)) / (0.15 * cols)
    change = load_n * (-12 * np.exp(-(away**2)) + 2 * np.exp(-((away - 2.2) ** 2)))
    noise = rng.normal(0, 0.7, skin.shape)
    return np.clip(skin + change[..., None] + noise, 0, 255).astype(np.uint8)


def grey(image: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)


def mixed_of(image: np.ndarray, skin: np.ndarray) -> np.ndarray:
    """As the original's collect_data.py writes it."""
    change = grey(skin).astype(np.float32) - grey(image)
    return encode_mixed_image(
        Deformation(np.maximum(change, 0), np.maximum(-change, 0), grey(skin).astype(np.float32), mm_per_px=0.5)
    )


def wrench_about_sensor(load_n: float, seed: int = 0) -> np.ndarray:
    """A press with some shear; torques about 35 mm below the skin."""
    rng = np.random.default_rng([seed, 5])
    shear = rng.uniform(-0.3, 0.3, 2) * load_n
    force = np.array([*shear, -load_n])
    at_skin = rng.normal(0, 0.002, 3)
    return np.concatenate([force, at_skin + np.cross([0, 0, 0.035], force)])


@dataclass
class LittleTree:
    """The original project's folder, a pair at a time."""

    root: Path
    skin: np.ndarray

    def add(self, thing: str, stem: str, load_n: float, seed: int) -> None:
        image, wrench = touched(self.skin, load_n, seed), wrench_about_sensor(load_n, seed)
        self.put_image("image", thing, stem, image)
        self.put_image("mixed_image", thing, stem, mixed_of(image, self.skin))
        self.put_wrench(thing, stem, wrench)
        self.put_wrench(thing, f"{stem}_norm", (wrench - LOWEST) / SPAN)

    def put_image(self, kind: str, thing: str, stem: str, image: np.ndarray) -> Path:
        path = self.root / kind / thing / f"{stem}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(cv2.imencode(".png", image)[1].tobytes())
        return path

    def put_wrench(self, thing: str, stem: str, six: np.ndarray) -> Path:
        path = self.root / "wrench" / thing / f"{stem}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        np.save(path, six)
        return path


def little_tree(root: Path, objects: int = 2, pairs: int = 3) -> LittleTree:
    """Two objects with three pairs each."""
    tree = LittleTree(root, untouched())
    for thing in range(1, objects + 1):
        for number in range(1, pairs + 1):
            tree.add(str(thing), str(number), 1.5 + number, seed=10 * thing + number)
    return tree


def little_episode(path: Path, steps: int = 5, seed: int = 0, **changes: object) -> dict[str, np.ndarray]:
    """A press that grows, as the transformer's episodes have it; what was written."""
    skin = untouched(seed, 24, 24)
    loads = np.linspace(0.1, 4, steps)
    arrays: dict[str, object] = {
        "tactile_img": np.array([touched(skin, load, seed)[..., ::-1] for load in loads]),
        "ref_frame": skin[..., ::-1],
        "6d_force": np.array([[0.1 * load, 0, -load, 0, 0, 0] for load in loads]) + 1.5,
        "ref_force": np.full(6, 1.5),
        "probe": np.array(3),
        "mode": np.array("static"),
        **changes,
    }
    arrays = {name: value for name, value in arrays.items() if value is not None}
    path.parent.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
    return arrays  # type: ignore[return-value]

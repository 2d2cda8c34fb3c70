"""Height maps whose shape is known in closed form."""

from dataclasses import replace

import numpy as np

from ninedtact.quantities import HeightMap, HeightSource, centred_axis_mm

MM_PER_PX = 0.051
RADIUS_MM, DEPTH_MM = 4.0, 1.9


def skin(
    z_mm: np.ndarray, source: np.ndarray | None = None, noise_mm: float = 0.0, camera_mm: float = np.inf
) -> HeightMap:
    """A height map, all of it measured unless said otherwise."""
    measured = np.full(z_mm.shape, HeightSource.MEASURED, np.uint8)
    chosen = measured if source is None else source
    return HeightMap(z_mm.astype(np.float32), chosen, MM_PER_PX, noise_mm, camera_mm, stamp_ns=7)


def grid(rows: int, cols: int) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.meshgrid(centred_axis_mm(cols, MM_PER_PX), centred_axis_mm(rows, MM_PER_PX))
    return x.astype(float), y.astype(float)


def plane(rows: int, cols: int, slope_x: float, slope_y: float, camera_mm: float = np.inf) -> HeightMap:
    """The plane z = slope_x·x + slope_y·y, as a camera at this distance sees it."""
    u, v = grid(rows, cols)
    rise = slope_x * u + slope_y * v
    return skin(rise / (1 - rise / camera_mm), camera_mm=camera_mm)


def ball_print(
    rows: int = 345, cols: int = 460, at: tuple[float, float] = (0.0, 0.0), camera_mm: float = np.inf
) -> HeightMap:
    """The imprint that a rigid ball would leave in a skin that does not bulge, as a camera at this distance sees it."""
    u, v = grid(rows, cols)
    nearness = 1 / camera_mm
    # The line of sight (u·k, v·k, z) with k = 1 + z/D meets the ball where a·z² + 2·b·z + c = 0; the camera sees the
    # lower of the two.
    x, y, up = u - at[0], v - at[1], RADIUS_MM - DEPTH_MM
    a = 1 + (u * u + v * v) * nearness**2
    b = (u * x + v * y) * nearness - up
    c = x * x + y * y + up * up - RADIUS_MM**2
    z_mm = (-b - np.sqrt(np.maximum(b * b - a * c, 0))) / a
    return skin(np.where(b * b > a * c, np.minimum(z_mm, 0), 0), camera_mm=camera_mm)


def with_hole(height: HeightMap) -> HeightMap:
    """The same skin with a corner and a block in the middle out of view, their heights not numbers."""
    source, z_mm = height.source.copy(), height.z_mm.copy()
    rows, cols = source.shape
    for hidden in (np.s_[:5, :7], np.s_[rows // 2 : rows // 2 + 4, cols // 2 : cols // 2 + 6]):
        source[hidden], z_mm[hidden] = HeightSource.OUT_OF_VIEW, np.nan
    return replace(height, source=source, z_mm=z_mm)

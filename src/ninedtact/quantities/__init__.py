"""The quantities that packages exchange: frames, height maps, wrenches and their parts. Each object carries its own scale, unit and
time stamp, and none shares memory with the next result.

The axes are the same in the whole package: the origin is the centre of the undeformed skin; x runs along image columns, y along
image rows, z outward through the skin (right-handed, as the camera sees it). Arrays are (rows, cols). The centre of an array of n
samples is at index (n − 1)/2. Lengths are in mm; stamps are in ns of the monotonic clock, taken on arrival.
"""

from ninedtact.quantities.shape import (
    Frame,
    HeightMap,
    HeightSource,
    Mesh,
    PointCloud,
    Rectified,
    centred_axis_mm,
)
from ninedtact.quantities.wrench_and_traction import (
    Deformation,
    EstimateWarning,
    Traction,
    Wrench,
    WrenchEstimate,
    independent_errors,
)

__all__ = [
    "Deformation",
    "EstimateWarning",
    "Frame",
    "HeightMap",
    "HeightSource",
    "Mesh",
    "PointCloud",
    "Rectified",
    "Traction",
    "Wrench",
    "WrenchEstimate",
    "centred_axis_mm",
    "independent_errors",
]

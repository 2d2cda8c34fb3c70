"""The wrenches of a data set beside the real ones."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.simulation.simulated_sources import FORCE_TORQUE_BELOW_SKIN_MM

AXES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
RANKS = (5, 50, 95)
REAL = np.array(
    [
        (-1.064, 0.146, 1.442),
        (-1.894, -0.414, 1.007),
        (-10.829, -6.965, -2.110),
        (-0.0489, 0.0134, 0.0769),
        (-0.0528, 0.0047, 0.0679),
        (-0.0079, 0.0002, 0.0076),
    ]
)
"""Percentiles of 10,000 real wrenches on 175 objects, N and N·m about 35 mm below the skin (docs/references.md)."""

Wrenches = Float[Array, "n 6"]
Percentiles = Float[Array, "6 3"]


def about_sensor(six: Wrenches) -> Wrenches:
    """Wrenches about the skin's centre, moved to where the paper's force/torque sensor sits."""
    arm_m = np.array([0.0, 0.0, FORCE_TORQUE_BELOW_SKIN_MM / 1e3])
    return np.concatenate([six[:, :3], six[:, 3:] + np.cross(arm_m, six[:, :3])], axis=1)


def percentiles(six: Wrenches) -> Percentiles:
    """5, 50 and 95 of every axis, about the force/torque sensor."""
    return np.asarray(np.percentile(about_sensor(six), RANKS, axis=0).T)


def off(found: Percentiles) -> Percentiles:
    """Difference from the real ones as a part of each axis's real span from 5 to 95."""
    return (found - REAL) / (REAL[:, 2:] - REAL[:, :1])


def by_axis(values: Percentiles) -> dict[str, list[float]]:
    """For a script."""
    return dict(zip(AXES, values.tolist(), strict=True))


def lines(six: Wrenches) -> Iterator[str]:
    """A table for a person."""
    found = percentiles(six)
    yield f"{len(six)} pairs by the rule, N and N·m about {FORCE_TORQUE_BELOW_SKIN_MM:g} mm below the skin; percentiles 5, 50, 95:"
    yield f"    {'this data set':28}{'real':28}off, % of the real span"
    for axis, ours, real, part in zip(AXES, found, REAL, 100 * off(found), strict=True):
        places = 2 if axis.startswith("F") else 4
        both = ["".join(f"{value:9.{places}f}" for value in values) for values in (ours, real)]
        yield f"{axis} {both[0]} {both[1]}  {''.join(f'{value:+5.0f}' for value in part)}"

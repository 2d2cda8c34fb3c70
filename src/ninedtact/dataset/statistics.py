"""Statistics of a data set: counts of kinds, sensors and objects, and percentiles of its wrenches beside those of real ones."""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.dataset.parquet_files import read_columns, wrench_array
from ninedtact.dataset.schema import NO_OBJECT, WRENCH_AXES
from ninedtact.simulation.simulated_sources import FORCE_TORQUE_BELOW_SKIN_MM

_RANKS = (5, 50, 95)
REAL_PERCENTILES = np.array(
    [
        (-1.064, 0.146, 1.442),
        (-1.894, -0.414, 1.007),
        (-10.829, -6.965, -2.110),
        (-0.0489, 0.0134, 0.0769),
        (-0.0528, 0.0047, 0.0679),
        (-0.0079, 0.0002, 0.0076),
    ]
)
"""Percentiles 5, 50 and 95 of 10,000 real wrenches on 175 objects, N and N·m about 35 mm below the skin (docs/references.md)."""

_Wrenches = Float[Array, "n 6"]
_Percentiles = Float[Array, "6 3"]


@dataclass(frozen=True, eq=False)
class DatasetStatistics:
    """Counts of the pairs of a data set, and the wrenches that percentiles are taken of."""

    kinds: dict[str, int]
    sensors: dict[str, int]
    objects: dict[str, int]
    rule_wrenches: _Wrenches
    """The finite wrenches of the pairs that the sampling rule kept, or of all pairs if it kept none; about the skin's centre."""

    @property
    def pairs(self) -> int:
        """Number of pairs of all kinds."""
        return sum(self.kinds.values())

    @property
    def object_count(self) -> int:
        """Number of different objects; the absence of an object is not counted."""
        return len(set(self.objects) - {NO_OBJECT})

    @property
    def percentiles(self) -> dict[str, list[float]]:
        """Percentiles 5, 50 and 95 of every axis about the paper's force/torque sensor; raises `IndexError` without wrenches."""
        return _by_axis(wrench_percentiles(self.rule_wrenches))

    @property
    def percentile_errors(self) -> dict[str, list[float]]:
        """Differences of the percentiles from the real ones, as parts of each axis's real span from 5 to 95."""
        return _by_axis(percentile_errors(wrench_percentiles(self.rule_wrenches)))

    def kind_counts_text(self) -> str:
        """Return the counts by kind as one phrase."""
        return ", ".join(f"{count} {kind}" for kind, count in self.kinds.items())

    def percentile_lines(self) -> Iterator[str]:
        """Yield a table of the percentiles beside the real ones as lines of text."""
        if not len(self.rule_wrenches):
            yield "no finite wrench"
            return
        found = wrench_percentiles(self.rule_wrenches)
        errors_percent = 100 * percentile_errors(found)
        yield (
            f"{len(self.rule_wrenches)} pairs by the rule, N and N·m about {FORCE_TORQUE_BELOW_SKIN_MM:g} mm below the skin; "
            "percentiles 5, 50, 95:"
        )
        yield f"    {'this data set':28}{'real':28}difference, % of the real span"
        for axis, ours, real, errors in zip(WRENCH_AXES, found, REAL_PERCENTILES, errors_percent, strict=True):
            decimals = 2 if axis.startswith("F") else 4
            ours_text, real_text = ("".join(f"{value:9.{decimals}f}" for value in values) for values in (ours, real))
            yield f"{axis} {ours_text} {real_text}  {''.join(f'{value:+5.0f}' for value in errors)}"


def compute_dataset_statistics(pair_files: Sequence[Path]) -> DatasetStatistics:
    """Count what is in the files of pairs of a data set; raises `DatasetDamaged`."""
    table = read_columns(pair_files, ("kind", "sensor", "object", "wrench"))
    kinds = [kind or "rule" for kind in table["kind"].to_pylist()]
    wrenches = wrench_array(table).astype(float)
    by_rule = np.array([kind == "rule" for kind in kinds], bool)
    wrenches = wrenches[by_rule] if by_rule.any() else wrenches
    sensors, objects = ([name or "" for name in table[column].to_pylist()] for column in ("sensor", "object"))
    finite = wrenches[np.isfinite(wrenches).all(1)]
    return DatasetStatistics(_count_names(kinds), _count_names(sensors), _count_names(objects), finite)


def _count_names(names: Sequence[str]) -> dict[str, int]:
    return dict(sorted(Counter(names).items()))


def wrench_percentiles(wrenches: _Wrenches) -> _Percentiles:
    """Return percentiles 5, 50 and 95 of every axis about the paper's force/torque sensor, of wrenches about the skin's centre."""
    return np.asarray(np.percentile(move_to_force_sensor(wrenches), _RANKS, axis=0).T)


def move_to_force_sensor(wrenches: _Wrenches) -> _Wrenches:
    """Return wrenches about the skin's centre as wrenches about the position of the paper's force/torque sensor."""
    arm_m = np.array([0.0, 0.0, FORCE_TORQUE_BELOW_SKIN_MM / 1e3])
    return np.concatenate([wrenches[:, :3], wrenches[:, 3:] + np.cross(arm_m, wrenches[:, :3])], axis=1)


def percentile_errors(found: _Percentiles) -> _Percentiles:
    """Return the differences from `REAL_PERCENTILES` as parts of each axis's real span from 5 to 95."""
    return (found - REAL_PERCENTILES) / (REAL_PERCENTILES[:, 2:] - REAL_PERCENTILES[:, :1])


def _by_axis(values: _Percentiles) -> dict[str, list[float]]:
    return dict(zip(WRENCH_AXES, values.tolist(), strict=True))

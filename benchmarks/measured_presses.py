"""Presses that a laboratory measured on sensors of this kind, beside the mechanics of the twin.

`--data` is a folder with ladders.csv, ball8_ramps.csv and shear_ball8.csv (unit, probe, repeat, depth, force; docs/accuracy.md),
by default real_force beside the real images; a unit is named RECIPE_THICKNESSmm_RUN. Three models predict the loads: gel on a
rigid base with one shear modulus for each recipe, gel on one base for all units, and the same with a modulus for each unit. The
depth at which a ramp begins is uncertain by some hundredths of a millimetre and is fitted for each ramp. Then each probe is
predicted from the others of its unit, and shear from normal presses alone. `--base-mm` is the thickness of the base, which is not
known of these units; the modulus that is found goes with it.
"""

import csv
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import tyro
from figures import Figure, answer, at_most, holds
from real_images import REAL
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import least_squares

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.finite_strain import correct_for_finite_strain
from ninedtact.mechanics.height_grid_indenter import indenter_from_heights
from ninedtact.mechanics.indenter import Ball, FlatPunch, Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, gel_skin

GRID = PeriodicGrid(108, 108, 0.2)
DEPTHS_MM = np.array([0.02, 0.1, 0.2, 0.35, 0.5, 0.7, 0.9, 1.2, 1.6, 2.0])
GEL_OVER_BASE = np.array([0.0, 0.04, 0.1, 0.2, 0.4, 0.7, 1.1, 1.7, 2.6, 4.0])
LEAST_N = 0.3
"""Load from which relative errors count."""
ZERO_STD_MM = {"ball8": 0.3}
"""Standard deviation of the depth at which a ramp begins, by probe; 0.03 mm for the others."""
FRICTION = 1.0
CUBE_PITCH_MM = 0.05


@dataclass(frozen=True)
class Ramp:
    """Loads of one probe on one unit, in the order of the file."""

    unit: str
    probe: str
    depth_mm: np.ndarray
    force_n: np.ndarray
    base_mm: float
    """Thickness of the layer below the gel that is assumed."""

    @property
    def recipe(self) -> str:
        return self.unit.split("_")[0]

    @property
    def thickness_mm(self) -> float:
        return float(self.unit.split("_")[1].removesuffix("mm"))


def measured_presses(
    data: Path = REAL.parent / "real_force", base_mm: float = 9.2, quick: bool = False, json: bool = False
) -> None:
    """Fit the models to all presses and print their errors; a minute. quick: two ramps of one unit."""
    ramps = read_ramps(data, base_mm)
    if quick:
        ramps = [ramp for ramp in ramps if ramp.unit == ramps[0].unit][:2]
    recipes, units = (list(dict.fromkeys(names)) for names in ([r.recipe for r in ramps], [r.unit for r in ramps]))
    rigid = fit(ramps, recipes, lambda ramp: ramp.recipe, is_rigid=True)
    shared = fit(ramps, recipes, lambda ramp: ramp.recipe)
    single = fit(ramps, units, lambda ramp: ramp.unit)
    figures = [
        Figure("one modulus for a recipe, rigid base: error above 0.3 N, %", 100 * rigid.error),
        at_most("one modulus for a recipe, one base: error above 0.3 N, %", 100 * shared.error, 4.0),
        Figure("one modulus for a unit, one base: error above 0.3 N, %", 100 * single.error),
        Figure("shear modulus of the base, MPa", shared.base_mpa),
        *(Figure(f"shear modulus of the gel {name}, MPa", value) for name, value in shared.modulus_mpa.items()),
    ]
    for probe in dict.fromkeys(ramp.probe for ramp in ramps):
        figures.append(at_most(f"{probe}, one base: error above 0.3 N, %", 100 * shared.error_of(probe), 5.0))
    figures += predictions_across_probes(ramps, shared)
    if not quick:
        figures += shear_predictions(data / "shear_ball8.csv", shared, base_mm)
    answer("measured presses", figures, json)


def read_ramps(data: Path, base_mm: float) -> list[Ramp]:
    """Return all ramps of a folder; ends the program with a sentence where there are none."""
    if not (data / "ladders.csv").is_file():
        sys.exit(f"expected ladders.csv and ball8_ramps.csv in {data}, got no such files; give --data")
    rows: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    for file, probe in (("ladders.csv", None), ("ball8_ramps.csv", "ball8")):
        with (data / file).open() as table:
            for row in csv.DictReader(table):
                key = row["unit"], probe or row["probe"], row.get("repeat", "1")
                rows.setdefault(key, []).append((float(row["depth_mm"]), float(row["force_N"])))
    return [Ramp(unit, probe, *np.array(points).T, base_mm) for (unit, probe, _), points in rows.items()]


def probe_indenter(probe: str) -> Indenter:
    """Return the object of a probe's name: its kind, and its diameter or side in mm."""
    kind, size = probe.rstrip("0123456789"), float(probe.lstrip("abcdefghijklmnopqrstuvwxyz"))
    if kind == "ball":
        return Ball(size / 2)
    if kind == "cyl":
        return FlatPunch(size / 2)
    return indenter_from_heights("cube", np.zeros((round(size / CUBE_PITCH_MM) + 1,) * 2), CUBE_PITCH_MM)


@cache
def load_table(probe: str, thickness_mm: float, base_mm: float) -> RegularGridInterpolator:
    """Return load over shear modulus, mm², by modulus of the gel over that of the base and by depth."""
    indenter, depths = probe_indenter(probe), DEPTHS_MM[0.8 * thickness_mm > DEPTHS_MM]
    loads = []
    for ratio in GEL_OVER_BASE:
        gel = Gel(thickness_mm, 1.0, base_thickness_mm=base_mm, gel_to_base_modulus_ratio=float(ratio))
        model = ContactModel(gel_skin(GRID, gel), FRICTION, SolverSettings(tolerance=2e-3, must_converge=False))
        contacts = model.follow(indenter, [Pose(depth_mm=float(depth)) for depth in depths])
        corrected = (correct_for_finite_strain(contact) for contact in contacts)
        loads.append([0.0, *(float(contact.pressure_mpa.sum()) * GRID.cell_area_mm2 for contact in corrected)])
    return RegularGridInterpolator((GEL_OVER_BASE, np.append(0.0, depths)), np.array(loads), bounds_error=False)


@dataclass(frozen=True)
class Fitted:
    """Moduli and zeros of depth that fit ramps best."""

    ramps: Sequence[Ramp]
    modulus_mpa: dict[str, float]
    base_mpa: float
    """Shear modulus of the base; infinite where it is rigid."""
    predicted_n: Sequence[np.ndarray]

    @property
    def error(self) -> float:
        """Mean relative error of the loads that count."""
        return relative_error(zip(self.ramps, self.predicted_n, strict=True))

    def error_of(self, probe: str) -> float:
        """Return that of one probe."""
        pairs = zip(self.ramps, self.predicted_n, strict=True)
        return relative_error((ramp, load) for ramp, load in pairs if ramp.probe == probe)


def relative_error(pairs: Iterable[tuple[Ramp, np.ndarray]]) -> float:
    """Return the mean relative error of the loads that count."""
    errors = [np.abs(load / ramp.force_n - 1)[ramp.force_n > LEAST_N] for ramp, load in pairs]
    return float(np.concatenate(errors).mean())


def predict_n(ramp: Ramp, modulus_mpa: float, base_mpa: float, zero_mm: float) -> np.ndarray:
    """Return the loads of a ramp, N."""
    table = load_table(ramp.probe, ramp.thickness_mm, ramp.base_mm)
    depth_mm = np.clip(ramp.depth_mm - zero_mm, 0, table.grid[1][-1])
    ratio = np.full_like(depth_mm, np.clip(modulus_mpa / base_mpa, 0, GEL_OVER_BASE[-1]))
    return modulus_mpa * table(np.stack([ratio, depth_mm], axis=-1))


def fit(
    ramps: Sequence[Ramp],
    names: Sequence[str],
    name_of: Callable[[Ramp], str],
    is_rigid: bool = False,
    base_mpa: float | None = None,
) -> Fitted:
    """Fit a modulus for each name and a zero for each ramp, and the base where it is neither rigid nor given."""
    fixed = np.inf if is_rigid else base_mpa

    def unpack(vector: np.ndarray) -> tuple[dict[str, float], float, np.ndarray]:
        moduli = dict(zip(names, np.exp(vector[: len(names)]).tolist(), strict=True))
        base = float(np.exp(vector[len(names)])) if fixed is None else fixed
        return moduli, base, vector[-len(ramps) :]

    def predict(vector: np.ndarray) -> list[np.ndarray]:
        moduli, base, zeros = unpack(vector)
        return [predict_n(r, moduli[name_of(r)], base, z) for r, z in zip(ramps, zeros, strict=True)]

    def residual(vector: np.ndarray) -> np.ndarray:
        loads = predict(vector)
        misfit = [(load - r.force_n) / np.hypot(0.05 * r.force_n, 0.02) for r, load in zip(ramps, loads, strict=True)]
        zeros = [z / ZERO_STD_MM.get(r.probe, 0.03) for r, z in zip(ramps, vector[-len(ramps) :], strict=True)]
        return np.concatenate([*misfit, zeros])

    start = np.concatenate(
        [np.full(len(names), np.log(0.1)), *([] if fixed is not None else [[0.0]]), np.zeros(len(ramps))]
    )
    found = least_squares(residual, start, loss="soft_l1").x
    moduli, base, _ = unpack(found)
    return Fitted(ramps, moduli, base, predict(found))


def predictions_across_probes(ramps: Sequence[Ramp], shared: Fitted) -> list[Figure]:
    """Return the error of each probe of a unit with the modulus that the other probes of the unit give."""
    figures = []
    for unit in dict.fromkeys(ramp.unit for ramp in ramps):
        own = [ramp for ramp in ramps if ramp.unit == unit]
        for probe in dict.fromkeys(ramp.probe for ramp in own):
            others = [ramp for ramp in own if ramp.probe != probe]
            if not others:
                continue
            known = fit(others, [unit], lambda ramp: ramp.unit, base_mpa=shared.base_mpa)
            asked = [ramp for ramp in own if ramp.probe == probe]
            if not any((ramp.force_n > LEAST_N).any() for ramp in asked):
                continue
            loads = [best_zero(ramp, known.modulus_mpa[unit], known.base_mpa) for ramp in asked]
            name = f"{unit}: {probe} from the other probes, error above 0.3 N, %"
            figures.append(at_most(name, 100 * relative_error(zip(asked, loads, strict=True)), 6.0))
    return figures


def best_zero(ramp: Ramp, modulus_mpa: float, base_mpa: float) -> np.ndarray:
    """Return the loads of a ramp with known moduli, the depth at which it begins being free."""

    def residual(zero: np.ndarray) -> np.ndarray:
        load = predict_n(ramp, modulus_mpa, base_mpa, float(zero[0]))
        misfit = (load - ramp.force_n) / np.hypot(0.05 * ramp.force_n, 0.02)
        return np.append(misfit, zero / ZERO_STD_MM.get(ramp.probe, 0.03))

    return predict_n(ramp, modulus_mpa, base_mpa, float(least_squares(residual, [0.0]).x[0]))


def shear_predictions(file: Path, shared: Fitted, base_mm: float) -> list[Figure]:
    """Return load and lateral force of a ball that is held at a depth and moved, over those that were measured.

    Beside them stands the compliance in series with the gel, as that of a probe, with which the lateral force would be right.
    """
    with file.open() as table:
        rows = [row for row in csv.DictReader(table) if row["segment"].endswith("_out")]
    figures = []
    for segment in dict.fromkeys((row["cycle"], row["segment"]) for row in rows):
        own = [row for row in rows if (row["cycle"], row["segment"]) == segment]
        columns = ("tcp_x_mm", "tcp_y_mm", "depth_mm", "Fx_base_N", "Fy_base_N", "Fz_base_N")
        x, y, depth_mm, f_x, f_y, f_z = np.array([[float(row[name]) for name in columns] for row in own]).T
        way = np.hypot(x[-1] - x[0], y[-1] - y[0])
        measured = np.hypot(f_x[-1] - f_x[0], f_y[-1] - f_y[0])
        ramp = Ramp(own[0]["unit"], "ball8", np.array([np.nanmean(depth_mm)]), -np.array([f_z.mean()]), base_mm)
        modulus = shared.modulus_mpa.get(ramp.recipe)
        if modulus is None:
            continue
        load_n = float(predict_n(ramp, modulus, shared.base_mpa, 0.0)[0])
        drag_n = drag_force_n(ramp, modulus, shared.base_mpa, float(way))
        name = f"{ramp.unit} {segment[1]}"
        figures.append(Figure(f"{name}: load at its depth over measured, %", 100 * load_n / float(ramp.force_n[0])))
        title = f"{name}: force of a drag by {way:.2f} mm over measured, %"
        figures.append(holds(title, 100 * drag_n / measured, "88 to 112", 0.88 <= drag_n / measured <= 1.12))
        figures.append(
            Figure(f"{name}: lateral over normal force that was measured", float(measured / ramp.force_n[0]))
        )
        figures.append(
            Figure(f"{name}: compliance that is missing in series, mm/N", float(way / measured - way / drag_n))
        )
    return figures


def drag_force_n(ramp: Ramp, modulus_mpa: float, base_mpa: float, way_mm: float) -> float:
    """Return the lateral force on a ball of 8 mm diameter that is pressed with the load of a ramp and then moved."""
    ratio, load_n = modulus_mpa / base_mpa, float(ramp.force_n[0])
    gel = Gel(ramp.thickness_mm, modulus_mpa, base_thickness_mm=ramp.base_mm, gel_to_base_modulus_ratio=ratio)
    model = ContactModel(gel_skin(GRID, gel), FRICTION, SolverSettings(tolerance=2e-3, must_converge=False))
    contact = model.step_to_load(model.initial_contact(), Ball(4.0), Pose(depth_mm=0.2), load_n)
    for share in (0.25, 0.5, 0.75, 1.0):
        pose = Pose(share * way_mm, 0.0, contact.pose.depth_mm)
        contact = model.step_to_load(contact, Ball(4.0), pose, load_n)
    return float(correct_for_finite_strain(contact).wrench().force_n[0])


if __name__ == "__main__":
    tyro.cli(measured_presses)

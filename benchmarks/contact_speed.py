"""Contact mechanics on one thread: a step of a live press, and a cold solve beside tamaas, the C++ library of the field.

Warm: a ball is pressed into the gel, dragged and lifted, as the live twin does it; one step is timed, from overlap to the
whole grid's displacements, in ms and in transforms there and back of the same grid. Cold: a ball and a rough surface are
pressed onto a half-space with a given load from nothing, 256 x 256, double precision, by both to the same largest gap or overlap.
Times are of the thread itself (median), in turns. tamaas (AGPL) is asked for here alone: pip install tamaas.
"""

from collections.abc import Callable, Iterator
from functools import partial
from importlib.util import find_spec
from itertools import chain, cycle
from typing import Any

import numpy as np
import tyro
from figures import Figure, answer, at_most
from jaxtyping import Float64
from numpy import ndarray as Array
from turns import Tasks, Times, in_turns

from ninedtact.design import Gel
from ninedtact.mechanics.contact_model import ContactModel, SolverSettings
from ninedtact.mechanics.contact_result import Contact, periodic_image_error_mm
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.layer_compliance import half_space_compliance
from ninedtact.mechanics.normal_contact import ContactConstraint, PressureSolution, solve_pressure
from ninedtact.mechanics.numpy_or_torch_arrays import forward_transform, inverse_transform
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import PeriodicGrid, Skin, gel_skin, padded_grid
from ninedtact.simulation.twin import default_twin

AREA_MM, PITCH_MM, MARGIN_MM = (24.0, 18.0), 0.2, 4.0
BALL, GEL = Ball(4.0), Gel()
TOLERANCES = (1e-2, 1e-3)
WARM_MS = {1e-2: 5.0}
FRAME_MS, FRAME = 11.0, "live step and its 640 x 480 image"
"""90 frames a second."""
PAIR = "transform there and back"

POINTS, LOAD_N = 256, 3.0
GRID = PeriodicGrid(POINTS, POINTS, 0.1)
SURFACES = ("ball", "rough surface")
TARGET_MM = 1e-4
"""Largest gap or overlap of a cold solve; the ball sinks in 1.6 mm, the roughness is 0.1 mm."""


def contact_speed(rounds: int = 30, quick: bool = False, json: bool = False) -> None:
    """Measure, and print what it must reach."""
    others: dict[str, Callable[[], Tasks]] = {"tamaas": tamaas_tasks} if find_spec("tamaas") else {}
    times = in_turns({"ours": our_tasks, **others}, rounds, quick)
    figures = [*warm_figures(times), *cold_figures(times, bool(others)), *margin_figures()]
    answer("Contact mechanics, one thread", figures, json)


def warm_figures(times: dict[tuple[str, str], Times]) -> Iterator[Figure]:
    """Steps of a live press."""
    pair = times["ours", PAIR].median_cpu_ms
    grid = padded_grid(*AREA_MM, PITCH_MM, MARGIN_MM)
    yield Figure(f"{PAIR}, {grid.rows} x {grid.cols}, float32, ms", pair)
    for tolerance in TOLERANCES:
        step = times["ours", warm(tolerance)].median_cpu_ms
        name = f"{warm(tolerance)}, ms"
        yield at_most(name, step, WARM_MS[tolerance], "ms") if tolerance in WARM_MS else Figure(name, step)
        yield Figure("the same in transforms there and back", step / pair)
    frame = times["ours", FRAME].median_cpu_ms
    yield at_most(f"{FRAME}, ms", frame, FRAME_MS, "ms")
    yield Figure("the same in transforms there and back", frame / pair)


def cold_figures(times: dict[tuple[str, str], Times], with_tamaas: bool) -> Iterator[Figure]:
    """Cold solves beside tamaas."""
    for surface in SURFACES:
        ours = times["ours", surface].median_cpu_ms
        if with_tamaas:
            tamaas = times["tamaas", surface].median_cpu_ms
            yield at_most(f"half-space, {surface}: time / tamaas's", ours / tamaas, 1.0)
            yield Figure("both, ms", ours, peer=tamaas)
        else:
            yield Figure(f"half-space, {surface}, ms", ours, peer="not measured: pip install tamaas")


def margin_figures() -> Iterator[Figure]:
    """What the grid's margin leaves of the periodic images."""
    moves = [Pose(depth_mm=1.0), Pose(depth_mm=1.5), Pose(x_mm=0.5, depth_mm=1.5)]
    for margin in (0.0, 2.0, MARGIN_MM):
        model = ContactModel(gel_skin(padded_grid(*AREA_MM, PITCH_MM, margin), GEL, np.zeros(())))
        *_, contact = model.follow(BALL, moves)
        error = np.abs(periodic_image_error_mm(contact)) * 1e3
        middle = error[tuple(slice(cells // 2 - 20, cells // 2 + 20) for cells in error.shape)]
        yield Figure(f"periodic images, margin {margin:g} mm, µm", f"{error.max():.1f}, within 4 mm {middle.max():.2f}")


def our_tasks() -> Tasks:
    grid = padded_grid(*AREA_MM, PITCH_MM, MARGIN_MM)
    field = np.random.default_rng(0).normal(size=grid.shape).astype(np.float32)
    tasks: Tasks = {PAIR: lambda call: inverse_transform(forward_transform(field, grid.shape), grid.shape, grid.shape)}
    tasks |= {warm(tolerance): live_steps(grid, tolerance) for tolerance in TOLERANCES}
    tasks[FRAME] = live_frames()
    skin = Skin(GRID, GEL, np.zeros(()), half_space_compliance)
    return tasks | {name: partial(our_cold_solve, skin, surface(name)) for name in SURFACES}


def warm(tolerance: float) -> str:
    return f"warm step to {tolerance:g} of the depth"


def live_steps(grid: PeriodicGrid, tolerance: float) -> Callable[[int], Contact]:
    """One step further at each call, over and over."""
    model = ContactModel(gel_skin(grid, GEL), settings=SolverSettings(tolerance=tolerance))
    poses, contacts = cycle(live_poses()), [model.initial_contact()]

    def step(call: int) -> Contact:
        contacts[0] = model.step(contacts[0], BALL, next(poses))
        return contacts[0]

    return step


def live_frames() -> Callable[[int], object]:
    """The same through the default twin, with its image."""
    twin = default_twin()
    poses, presses = cycle(live_poses()), [twin.hover(BALL, Pose())]

    def frame(call: int) -> object:
        presses[0] = twin.press(presses[0], BALL, next(poses))
        return twin.renderer(presses[0].corrected, call)

    return frame


def live_poses() -> list[Pose]:
    """Down 1.5 mm, a millimetre across, and up again, at 30 Hz and some 1.5 mm/s."""
    down = [Pose(depth_mm=depth) for depth in np.arange(0.05, 1.51, 0.05)]
    across = [Pose(x_mm=x, depth_mm=1.5) for x in np.arange(0.05, 1.01, 0.05)]
    up = [Pose(x_mm=1.0, depth_mm=depth) for depth in np.arange(1.45, 0, -0.05)]
    return list(chain(down, across, up))


def surface(name: str) -> Float64[Array, "rows cols"]:
    """Heights over the plane of what is pressed on."""
    if name == "ball":
        x, y = GRID.positions_mm
        return (x**2 + y**2) / 8
    k = np.hypot(*GRID.wave_vectors)
    k[0, 0] = 1
    power = np.where(k < 8, np.maximum(k, 0.8) ** -1.8, 0.0)
    white = np.random.default_rng(0).normal(size=GRID.shape)
    heights = np.fft.irfft2(np.fft.rfft2(white) * power, s=GRID.shape)
    return (heights - heights.min()) * (0.1 / heights.std())


def our_cold_solve(skin: Skin, heights: Float64[Array, "rows cols"], call: int = 0) -> PressureSolution:
    none, held = np.zeros((1, 1)), ContactConstraint(LOAD_N / GRID.cell_area_mm2)
    even = held.scale_to_load(np.zeros(GRID.shape))
    indentation, step_length = (
        skin.operators.indentation_from_pressure_mm(even),
        skin.operators.first_step_lengths(none)[0],
    )
    start = PressureSolution(even, indentation, none, none, none, none, step_length)
    return solve_pressure(skin.operators, held, -heights, start, lambda deeper: none + 2 * TARGET_MM, 1000)


def tamaas_tasks() -> Tasks:
    import tamaas

    tamaas.initialize(1)
    tamaas.set_log_level(tamaas.LogLevel.error)
    return {name: tamaas_to_target(surface(name)) for name in SURFACES}


def tamaas_to_target(heights: Float64[Array, "rows cols"]) -> Callable[[int], object]:
    """Its solver with the loosest of its tolerances that reaches the target, from untouched skin at each call."""
    for tolerance in 10.0 ** -np.arange(1, 14, 0.25):
        solve, model = tamaas_solve(heights, tolerance)
        solve(0)
        if misfit_mm(model.traction, model.displacement, heights) <= TARGET_MM:
            return solve
    raise AssertionError("tamaas did not reach the target")


def tamaas_solve(heights: Float64[Array, "rows cols"], tolerance: float) -> tuple[Callable[[int], object], Any]:
    """Its solver, ready to go, and the model that then holds the answer."""
    import tamaas

    side = GRID.width_mm
    model = tamaas.ModelFactory.createModel(tamaas.model_type.basic_2d, [side, side], list(GRID.shape))
    model.E, model.nu = 2 * GEL.shear_modulus_mpa * (1 + GEL.poisson_ratio), GEL.poisson_ratio
    pressure = tamaas.PolonskyKeerRey.pressure
    solver = tamaas.PolonskyKeerRey(model, -heights, tolerance, pressure, pressure)
    solver.max_iter = 3000

    def solve(call: int) -> object:
        model.traction[:], model.displacement[:] = 0, 0
        return solver.solve(LOAD_N / side**2)

    return solve, model


def misfit_mm(
    pressure: Float64[Array, "rows cols"], sunk: Float64[Array, "rows cols"], heights: Float64[Array, "rows cols"]
) -> float:
    """The largest gap under pressure, or overlap without, in whichever solver's answer."""
    gap, pressed = sunk + heights, pressure > 0
    gap -= gap[pressed].mean()
    return float(np.where(pressed, np.abs(gap), -gap).max())


if __name__ == "__main__":
    tyro.cli(contact_speed)

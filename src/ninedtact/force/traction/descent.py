"""Conjugate gradients for a quadratic whose first part must not be negative (Polyak 1969; docs/force_physics.md).

A value at zero stays there while its gradient pushes it below; a step that would cross zero is cut off there, and the search
goes on from the new gradient.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32
from numpy import ndarray as Array

TINY = 1e-30
HARMLESS = 0.01
"""Of the largest pressure: less below zero is not worth a new gradient; it is cut off at the end."""

View = Float32[Array, "rows cols"]
Weights = Float32[Array, "2 modes"]


@dataclass(frozen=True)
class Unknown:
    """Pressure over the shear modulus, and weights of shear modes."""

    pressure: View
    weights: Weights

    def plus(self, step: float, other: "Unknown") -> "Unknown":
        """Some way along another."""
        size = np.float32(step)
        return Unknown(self.pressure + size * other.pressure, self.weights + size * other.weights)

    def dot(self, other: "Unknown") -> float:
        """Inner product."""
        return float(np.vdot(self.pressure, other.pressure)) + float(np.vdot(self.weights, other.weights))

    def on(self, free: View) -> "Unknown":
        """Pressure elsewhere set to zero."""
        return Unknown(self.pressure * free, self.weights)


@dataclass(frozen=True)
class Quadratic:
    """½ xᵀHx − bᵀx, where pressure may be."""

    curvature: Callable[[Unknown], Unknown]
    downhill_at_zero: Unknown
    """b"""
    preconditioned: Callable[[Unknown], Unknown]
    """Roughly H⁻¹."""
    touched: View


@dataclass(frozen=True)
class Descended:
    """Where the search has come to."""

    at: Unknown
    slope: Unknown
    """Downhill: b − Hx."""
    direction: Unknown | None = None
    last: Unknown | None = None
    """The slope before, where pressure was free."""
    now: float = np.inf
    """gᵀH⁻¹g before the last step, H⁻¹ as the preconditioner has it."""
    iterations: int = 0

    @property
    def off(self) -> float:
        """How far from the optimum: no sum of the unknowns is off by more of its own standard deviations (Cauchy and Schwarz)."""
        return float(np.sqrt(self.now))


def descended(problem: Quadratic, start: Unknown, most: int, enough: float) -> Descended:
    """Search for at most so many iterations, or until the answer is not off by more than `enough`."""
    now = Descended(start, problem.downhill_at_zero.plus(-1, problem.curvature(start)))
    while now.iterations < most and now.off > enough:
        now = further(problem, now)
    return replace(now, at=Unknown(np.maximum(now.at.pressure, 0), now.at.weights))


def further(problem: Quadratic, so_far: Descended) -> Descended:
    """One step."""
    free = problem.touched * ((so_far.at.pressure > 0) | (so_far.slope.pressure > 0))
    slope = so_far.slope.on(free)
    towards = problem.preconditioned(slope).on(free)
    now = slope.dot(towards)
    direction = towards
    if so_far.direction is not None and so_far.last is not None and so_far.iterations:
        ratio = max(now - so_far.last.dot(towards), 0.0) / max(so_far.now, TINY)
        direction = towards.plus(ratio, so_far.direction).on(free)
    direction = inwards(direction, so_far.at)
    at, downhill = stepped(problem, so_far, direction, slope)
    return Descended(at, downhill, direction, slope, now, so_far.iterations + 1)


def inwards(direction: Unknown, at: Unknown) -> Unknown:
    """Without what would leave at once where pressure is zero."""
    leaves = (at.pressure <= 0) & (direction.pressure < 0)
    return Unknown(np.where(leaves, np.float32(0), direction.pressure), direction.weights)


def stepped(problem: Quadratic, so_far: Descended, direction: Unknown, slope: Unknown) -> tuple[Unknown, Unknown]:
    """To the lowest point along a direction, and pressure cut off at zero; the new slope."""
    bent = problem.curvature(direction)
    stride = slope.dot(direction) / max(direction.dot(bent), TINY)
    at = so_far.at.plus(stride, direction)
    if at.pressure.min() >= -HARMLESS * float(at.pressure.max()):
        return at, so_far.slope.plus(-stride, bent)
    at = Unknown(np.maximum(at.pressure, 0), at.weights)
    return at, problem.downhill_at_zero.plus(-1, problem.curvature(at))

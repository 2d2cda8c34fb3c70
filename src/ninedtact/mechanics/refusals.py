"""What no contact is solved for: where the answer would be wrong, and nothing would say so."""

import numpy as np

from ninedtact.errors import NinedtactError
from ninedtact.mechanics.library import library_of
from ninedtact.mechanics.patch import Patch
from ninedtact.mechanics.per_contact import Count, Number
from ninedtact.mechanics.pose import PoseImpossible
from ninedtact.mechanics.response import Field


class NotConverged(NinedtactError):
    """The solver ran out of iterations before it reached its tolerance."""


class LoadImpossible(NinedtactError):
    """A load under which nothing rests on the skin."""


class ContactLeavesPatch(NinedtactError):
    """The contact reaches the patch's border, where it would meet its own image on the other side."""


def require_above_base(deepest_mm: float, thickness_mm: float) -> None:
    """Refuse an object that reaches through the gel, and heights that are no numbers; raises `PoseImpossible`."""
    if not deepest_mm < thickness_mm:
        raise PoseImpossible(
            f"expected the object less deep in the skin than its base, {thickness_mm:g} mm, got {deepest_mm:g} mm; "
            f"press less, or give the skin its true thickness"
        )


def require_inside(patch: Patch, field: Field) -> None:
    """Refuse pressure (or overlap) above zero at the border; raises `ContactLeavesPatch`."""
    xp = library_of(field)
    borders = {"left": field[..., 0], "right": field[..., -1], "upper": field[..., 0, :], "lower": field[..., -1, :]}
    reached = [name for name, border in borders.items() if bool(xp.any(border > 0))]
    if reached:
        raise ContactLeavesPatch(
            f"expected the contact inside the patch of {patch.width_mm:g} x {patch.height_mm:g} mm, got it at the "
            f"{' and '.join(reached)} border; give the patch a wider margin, or press less deep"
        )


def require_load(load_n: Number) -> None:
    """Refuse a load that does not press; raises `LoadImpossible`."""
    if not np.all((np.asarray(load_n) > 0) & np.isfinite(load_n)):
        raise LoadImpossible(
            f"expected a load above zero, got {load_n} N; press with a force, or lift the object off by its depth"
        )


def require_converged(residual_mm: Number, wanted_mm: Number, iterations: Count) -> None:
    """Refuse an answer that misses its tolerance; raises `NotConverged`."""
    residuals, wanted, counts = np.broadcast_arrays(np.atleast_1d(residual_mm), wanted_mm, iterations)
    missed = np.flatnonzero(~(residuals <= wanted))
    if len(missed):
        which, many = missed[0], f", {len(missed)} of {len(residuals)} contacts" if len(residuals) > 1 else ""
        raise NotConverged(
            f"expected the contact solved to {wanted[which]:.2g} mm, got {residuals[which]:.2g} mm after {counts[which]} "
            f"iterations{many}; take smaller steps, or allow more rounds"
        )

"""A press on a twin: an object in the skin, with the contact as it was solved and as the gel acts, and what it measures.

`twin.Twin.press` makes it, from the press before and a pose or a load: the one place where an object is pressed into a gel.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64
from numpy import ndarray as Array

from ninedtact.mechanics.contact_result import Contact
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.numpy_or_torch_arrays import ScalarPerContact, array_namespace_of, sum_over_grid, to_numpy
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.relaxation import GelMemory, relax_tractions
from ninedtact.mechanics.skin import Skin
from ninedtact.quantities import Wrench


@dataclass(frozen=True)
class Press:
    """An object in the skin of a twin: the contact as it was solved, and as it is rendered and measured. Or a batch of presses, one
    object on each skin, whose numbers are arrays; `unstack` gives them one by one.
    """

    solved: Contact
    """The contact of the linear layer, from which the next press continues."""
    corrected: Contact
    """The contact as the gel acts: the same where the gel is linear and has not relaxed."""
    indenter: Indenter
    memory: GelMemory | None = None
    """What the gel remembers of a single contact in the course of time; None where no time has passed."""

    @property
    def pose(self) -> Pose:
        """The pose of the object, with the depth that was found."""
        return self.solved.pose

    @property
    def wrench(self) -> Wrench:
        """What the object applies to the skin, about the middle of the undeformed skin; for a single press."""
        six = self._numbers[:6]
        return Wrench(six[:3], six[3:])

    @property
    def load_n(self) -> ScalarPerContact:
        """The load of the gel as it acts."""
        return number_of_single(-self._numbers[..., 2])

    @property
    def linear_load_n(self) -> ScalarPerContact:
        """The load of the linear layer."""
        return number_of_single(self._numbers[..., 6])

    @property
    def touches(self) -> bool:
        """Whether there is pressure anywhere, under any object of a batch."""
        return bool(self._numbers[..., 7].any())

    @property
    def contact_area_mm2(self) -> ScalarPerContact:
        """The area under pressure."""
        return number_of_single(self._numbers[..., 7] * self.solved.skin.grid.cell_area_mm2)

    @property
    def max_indentation_mm(self) -> ScalarPerContact:
        """The maximum indentation of the skin as it was solved."""
        return number_of_single(self._numbers[..., 8])

    @property
    def stiffening(self) -> ScalarPerContact:
        """The ratio of the load of the gel, before it relaxes, to that of the linear layer; one without contact."""
        return number_of_single(self._numbers[..., 9] / self.corrected.left)

    @property
    def slip_share(self) -> float | None:
        """Share of the contact that slips, 0 to 1; None without contact. For a single press."""
        touched = to_numpy(self.corrected.pressure_mpa) > 0
        return 1 - float(to_numpy(self.corrected.stick_mask)[touched].mean()) if touched.any() else None

    @cached_property
    def _numbers(self) -> Float64[Array, "*batch 10"]:
        """The wrench (N, N·m), linear load, points under pressure, indentation and stiffening."""
        solved, xp = self.solved, array_namespace_of(self.solved.height_mm)
        pressed, pressure = solved.pressure_mpa > 0, sum_over_grid(solved.pressure_mpa)
        ratio = sum_over_grid(self.corrected.pressure_mpa) / xp.where(pressure > 0, pressure, 1.0)
        deepest = -xp.min(solved.height_mm, axis=(-2, -1), keepdims=True)
        points = xp.astype(sum_over_grid(pressed), deepest.dtype)
        each = to_numpy(xp.concat((points, deepest, xp.where(pressure > 0, ratio, 1.0)), axis=-1))[..., 0, :]
        linear_n = sum_over_grid(xp.astype(solved.pressure_mpa, xp.float64)) * solved.skin.grid.cell_area_mm2
        six = to_numpy(self.corrected.wrenches()) if solved.pose.batch_shape else self.corrected.wrench().six
        return np.concatenate([six, to_numpy(linear_n)[..., 0], each], axis=-1)

    def relax(self, memory: GelMemory, after_s: float) -> "Press":
        """Return a single elastic press of a gel that remembers this of the time before, after some time."""
        memory = memory.after(after_s, float(self.load_n))
        return replace(
            self, corrected=relax_tractions(self.corrected, memory.left_of(float(self.load_n))), memory=memory
        )

    def on_skin(self, skin: Skin) -> "Press":
        """Return the press with its contacts in the array library and on the device of this skin."""
        solved = self.solved.on_skin(skin)
        corrected = solved if self.corrected is self.solved else self.corrected.on_skin(skin)
        press = Press(solved, corrected, self.indenter, self.memory)
        vars(press)["_numbers"] = self._numbers
        return press

    @staticmethod
    def stack(presses: "Sequence[Press]", indenter: Indenter) -> "Press":
        """Return single presses on equal grids as a batch of one indenter for all."""
        solved = Contact.stack([press.solved for press in presses])
        return Press(solved, Contact.stack([press.corrected for press in presses]), indenter)

    def unstack(self, indenters: Sequence[Indenter]) -> "list[Press]":
        """Return the presses of a batch one by one, each with its own object."""
        solved = self.solved.unstack()
        corrected = solved if self.corrected is self.solved else self.corrected.unstack()
        presses = [Press(*one) for one in zip(solved, corrected, indenters, strict=True)]
        for press, numbers in zip(presses, self._numbers, strict=True):
            vars(press)["_numbers"] = numbers  # computed for all at once, which a device does in the time of one
        return presses


def number_of_single(number: Float64[Array, "*batch"] | float) -> ScalarPerContact:
    """Return the number of a single press as a float, those of a batch as they are."""
    return float(number) if np.ndim(number) == 0 else number

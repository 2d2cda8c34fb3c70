"""Many twins of one sensor at once: a step takes poses or loads of all of them and gives presses, wrenches and images as tensors.

All fields stay on the device from step to step. The processor waits for it about nine times per step: for the region where objects
may touch, after each round of the solver for the contacts that have converged, and in the end for those that are refused. The
contacts are those of `Twin.press`, to a tolerance that keeps wrenches within a hundredth of the load.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float64, Int, UInt8
from numpy import ndarray as Array

from ninedtact.bounds import checks_arguments
from ninedtact.errors import DeviceError, InputError
from ninedtact.mechanics.active_region import (
    GridRectangle,
    SharedActiveRectangle,
    find_touchable_region,
    rectangle_around_both,
    region_of_rectangle,
)
from ninedtact.mechanics.contact_model import (
    SolverSettings,
    build_contact_problem_at_pose,
    deepest_of_solved_mm,
)
from ninedtact.mechanics.contact_result import (
    Contact,
    contact_limits,
    positive_at_border,
    require_positive_load,
)
from ninedtact.mechanics.height_grid_indenter import DeviceHeightGrids
from ninedtact.mechanics.indenter import NO_OBJECT_MM, Indenter
from ninedtact.mechanics.normal_contact import ContactConstraint
from ninedtact.mechanics.numpy_or_torch_arrays import max_over_grid, to_numpy
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import ScalarField
from ninedtact.simulation.press import Press
from ninedtact.simulation.renderer import BatchRenderer, Renderer
from ninedtact.simulation.twin import Twin

if TYPE_CHECKING:
    from torch import Tensor

_SOLVER_SETTINGS = SolverSettings(tolerance=3e-3, max_rounds=60, max_iterations=6, must_converge=False)
"""Rounds of few iterations, in which contacts keep step with each other and which a GPU can record. With this tolerance, wrenches
are within a hundredth of the load, which friction's memory would exceed with that of single presses."""
_IMAGES_AT_ONCE = 512
"""Images that are rendered together: enough to fill a GPU, and few enough for the memory of their refined fields."""


@checks_arguments
@dataclass
class TwinBatch:
    """Environments with one twin and one object each, which are pressed together.

    >>> batch = TwinBatch(ninedtact.default_twin(), [ninedtact.indenter_from_name("ball:4")] * 4)
    >>> press = batch.step(torch.tensor([[0.0, 0.0, 0.5, 0.0, 0.0, 0.0]]).expand(4, 6))
    >>> press.corrected.wrenches().shape, batch.images(press).shape
    (torch.Size([4, 6]), torch.Size([4, 480, 640]))
    """

    twin: Twin
    indenters: Sequence[Indenter]
    """The object of each environment."""
    device: str = "cpu"
    """The device of torch on which everything is computed."""
    renderer: Renderer | None = None
    """Renders the images; None: that of the twin."""
    refused: Bool[Array, " batch"] = field(init=False)
    """The environments whose last step was refused: the object left gel or grid, came too deep, or the contact was not solved.
    They were reset."""
    _last: Contact = field(init=False, repr=False)
    _rectangle: GridRectangle | None = field(default=None, init=False, repr=False)
    _frames: int = field(default=0, init=False, repr=False)

    def __post_init__(self) -> None:
        if not self.indenters:
            raise InputError(expected="at least one environment", got="none", remedy="give an object for each")
        self.twin = replace(self.twin, like=_zero_on(self.device), solver_settings=_SOLVER_SETTINGS)
        first, same = self.indenters[0], all(one is self.indenters[0] for one in self.indenters)
        self._indenter = first if same else DeviceHeightGrids(self.twin.like).batch(self.indenters)
        self.refused = np.zeros(self.count, bool)
        zero = Pose(*np.zeros((6, self.count)))
        blank = self.twin.model.initial_contact()
        each = {name: getattr(blank, name).expand(self.count, *[-1] * getattr(blank, name).ndim) for name in _FIELDS}
        self._last = replace(blank, pose=zero, **each)

    @property
    def count(self) -> int:
        """The number of environments."""
        return len(self.indenters)

    def reset(self, environments: Int[Array, " some"]) -> None:
        """Lift the objects of these environments off: their skin is undeformed, friction forgets. Raises `InputError`."""
        numbers = np.atleast_1d(np.asarray(environments, int))
        lifted = np.isin(np.arange(self.count), numbers)
        if not np.isin(numbers, np.arange(self.count)).all():
            raise InputError(
                expected=f"numbers of environments from 0 to {self.count - 1}",
                got=f"{numbers.tolist()}",
                remedy="correct them",
            )
        self._last = self._without(self._last, lifted)

    def step(self, poses: 'Float[Tensor, "batch 6"]', loads_n: 'Float[Tensor, " batch"] | None' = None) -> Press:
        """Return the presses after all objects have moved to these poses, or to these loads near them.

        poses: x, y, depth in mm, twist, tilt about x and about y in rad, as `Pose`; of any library with DLPack, on any device.
        loads_n: of the linear layer; the depths are first guesses then. Refused environments are undeformed skin in the result, see
        `refused`. Raises `InputError` for poses of another shape, not finite, or loads that do not press, and `DeviceError` without
        room for all environments; nothing was stepped then.
        """
        with self._full_memory_as_device_error():
            return self._step(poses, loads_n)

    def _step(self, poses: Any, loads_n: Any) -> Press:
        each = self._checked(poses, (self.count, 6), "poses (x, y, depth, twist and two tilts of each)")
        pose, constraint = Pose(*np.ascontiguousarray(each.T)), ContactConstraint()
        if loads_n is not None:
            wanted_n = self._checked(loads_n, (self.count,), "loads")
            require_positive_load(wanted_n)
            sums = wanted_n[:, None, None] / self.twin.model.skin.grid.cell_area_mm2
            constraint = ContactConstraint(self.twin.model.skin.asarray(sums))
        problem = build_contact_problem_at_pose(self._last, self._indenter, pose, constraint, self.twin.friction)
        reached_mm = problem.overlap_mm
        if loads_n is None:  # contacts that would be refused are not solved
            too_deep = ~(max_over_grid(reached_mm) < self.twin.gel.max_depth_mm)
            unsolvable = too_deep | positive_at_border(reached_mm)[:, None, None]
            problem = replace(problem, overlap_mm=reached_mm.masked_fill(unsolvable, -NO_OBJECT_MM))
        solved = self.twin.model.solve(problem, self._region(problem.overlap_mm))
        press = self.twin.finish_press(solved, self._indenter)
        refused = self._refused(solved, press, pose, reached_mm, loads_n is None)
        if refused.any():
            solved = self._without(solved, refused)
            press = self.twin.finish_press(solved, self._indenter)
        self._last, self.refused = solved, refused
        return press

    def images(self, press: Press, noise: bool = True) -> 'UInt8[Tensor, "batch rows cols"]':
        """Return grey images of all environments on the device, with noise that the twin's seed and the number of the call fix.

        Raises `InputError` for presses of another batch, and `DeviceError` without room for all images.
        """
        if press.corrected.height_mm.shape[0] != self.count:
            raise InputError(
                expected=f"the presses of {self.count} environments",
                got=f"those of {press.corrected.height_mm.shape[0]}",
                remedy="give what `step` of this batch returned",
            )
        with self._full_memory_as_device_error():
            return self._images(press, noise)

    def _images(self, press: Press, noise: bool) -> 'UInt8[Tensor, "batch rows cols"]':
        import torch

        renderer, contacts = self._renderer, press.corrected
        found = torch.empty((self.count, *self._reference.shape), dtype=torch.uint8, device=self.device)
        seed = (renderer.renderer.noise.seed << 24) + self._frames
        random = torch.Generator(self.device).manual_seed(seed)
        self._frames += 1
        for first in range(0, self.count, _IMAGES_AT_ONCE):
            part = range(first, min(first + _IMAGES_AT_ONCE, self.count))
            grey = renderer.brightness_factors(_slice(contacts, part)) * self._reference
            if noise:
                grey += renderer.renderer.noise.grey_levels * torch.randn(
                    grey.shape, generator=random, device=self.device
                )
            found[first : part.stop] = grey.round_().clamp_(0, 255)
        return found

    @contextmanager
    def _full_memory_as_device_error(self) -> Iterator[None]:
        import torch

        try:
            yield
        except torch.OutOfMemoryError as error:
            raise DeviceError(
                expected=f"room for {self.count} environments in the memory of {self.device}",
                got=str(error).split(". ")[0],
                remedy="take fewer, a coarser pitch, or end other programs that use it",
            ) from error

    @cached_property
    def _renderer(self) -> BatchRenderer:
        return BatchRenderer(self.renderer or self.twin.renderer, self.twin.like)

    @cached_property
    def _reference(self) -> 'Float[Tensor, "rows cols"]':
        import torch

        grey = cv2.cvtColor(self._renderer.renderer.reference, cv2.COLOR_BGR2GRAY)
        return torch.from_numpy(grey).to(self.device)

    def _checked(self, values: Any, shape: tuple[int, ...], what: str) -> Float64[Array, "..."]:
        """Return numbers of each environment on the processor; raises `InputError` for another shape or what is not finite."""
        import torch

        dlpack = hasattr(values, "__dlpack__") and not isinstance(values, torch.Tensor | np.ndarray)
        tensor = torch.utils.dlpack.from_dlpack(values) if dlpack else torch.as_tensor(values, dtype=torch.float64)
        numbers = to_numpy(tensor.detach())
        bad = "" if numbers.shape == shape else f"shape {numbers.shape}"
        if not bad and not np.isfinite(numbers).all():
            finite = np.isfinite(numbers).reshape(self.count, -1).all(axis=1)
            bad = f"some that are not, of environments {np.flatnonzero(~finite).tolist()}"
        if bad:
            raise InputError(
                expected=f"finite {what} of shape {shape}", got=bad, remedy="correct them; nothing was stepped"
            )
        return numbers

    def _region(self, overlap_mm: ScalarField) -> SharedActiveRectangle:
        """Return a region in which all objects can touch; it never shrinks, so that few sizes occur."""
        wanted = find_touchable_region(self.twin.model.skin, overlap_mm).rectangle
        last = self._rectangle or wanted
        self._rectangle = rectangle_around_both(last, wanted, self.twin.model.skin.grid.shape)
        return region_of_rectangle(self.twin.model.skin, self._rectangle)

    def _refused(
        self, solved: Contact, press: Press, pose: Pose, reached_mm: ScalarField, by_depth: bool
    ) -> Bool[Array, " batch"]:
        """Return which contacts left grid or gel, came too deep, were not solved, or would leave no gel."""
        limits = contact_limits(solved, press.corrected, reached_mm)
        beyond_gel = (limits.reach_mm > np.array(self.twin.gel_mm) / 2).any(axis=1)
        deepest_mm = deepest_of_solved_mm(solved, pose, limits.max_overlap_mm)
        too_deep = ~((deepest_mm < self.twin.gel.max_depth_mm) & (limits.least_gel_mm > 0))
        at_border = limits.at_border | (limits.overlap_at_border & by_depth)
        return beyond_gel | too_deep | at_border | ~np.isfinite(solved.residual_mm)

    def _without(self, contact: Contact, lifted: Bool[Array, " batch"]) -> Contact:
        """Return the contacts with undeformed skin in some environments."""
        import torch

        flags = torch.from_numpy(lifted).to(self.device)
        values = {
            name: (value := getattr(contact, name)).masked_fill(flags.view(-1, *[1] * (value.ndim - 1)), 0.0)
            for name in _FIELDS
        }
        return replace(contact, **values)


def _zero_on(device: str) -> "Tensor":
    """Return a zero in single precision on a device of torch; raises `InputError` where torch has no such device."""
    import torch

    try:
        return torch.zeros((), dtype=torch.float32, device=device)
    except (RuntimeError, AssertionError) as error:
        raise InputError(
            expected="a device of torch with free memory, as 'cpu' or 'cuda'",
            got=f"{device!r} ({str(error).splitlines()[0]})",
            remedy="give another, or a torch that is built for the GPU and its driver",
        ) from error


_FIELDS = ("pressure_mpa", "shear_mpa", "height_mm", "tangential_mm")


def _slice(contacts: Contact, part: range) -> Contact:
    cut = slice(part.start, part.stop)
    pose = Pose(
        *(
            np.broadcast_to(values, contacts.pose.batch_shape)[cut]
            for values in (getattr(contacts.pose, name.name) for name in fields(Pose))
        )
    )
    return replace(contacts, pose=pose, **{name: getattr(contacts, name)[cut] for name in _FIELDS})

"""Contacts per second, solved and drawn, many at a time, with torch on a GPU if there is one.

Beside it one at a time with NumPy on one CPU thread. Every contact is a ball at a depth, drag and twist of its own, in two
steps: pressed from untouched skin, then dragged and twisted; each step counts, and is drawn to a 640 x 480 picture where the
table says so. Sensing area and pitch of the live twin, single precision, to 1 % of the depth. Without a GPU the same runs on the
CPU, and the table says so: python benchmarks/gpu_contacts.py --device cpu
"""

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from time import perf_counter
from typing import Any

import numpy as np
import tyro
from figures import Figure, answer, at_least

from ninedtact.design import Gel
from ninedtact.mechanics.contact import Contact, ContactModel, Effort
from ninedtact.mechanics.indenter import Ball
from ninedtact.mechanics.patch import padded_patch
from ninedtact.mechanics.pose import Pose
from ninedtact.mechanics.skin import gel_skin
from ninedtact.simulation.batch import BatchRenderer
from ninedtact.simulation.twin import default_twin

AT_A_TIME = (16, 64, 256)
WANTED_PER_S = 500.0
"""Of drawn contacts, on a GPU."""
TWIN = default_twin()
ALONE = 16
PATCH, BALL, EFFORT = padded_patch(24, 18, 0.2, 4), Ball(4.0), Effort(tolerance=1e-2)


def gpu_contacts(
    device: str = "", at_a_time: tuple[int, ...] = AT_A_TIME, repeats: int = 3, json: bool = False
) -> None:
    """Measure; device: as torch names it, cuda where there is one unless said otherwise."""
    one_each = [Touch.some(1, seed) for seed in range(ALONE)]
    like = np.zeros((), np.float32)
    alone, drawn = per_second(like, one_each, repeats), per_second(like, one_each, repeats, TWIN.renderer)
    figures = [Figure("one at a time, NumPy, contacts per s", alone), Figure("the same, drawn", drawn)]
    if find_spec("torch") is None:
        figures.append(Figure("many at a time", "not measured: torch is not installed; pip install 'ninedtact[train]'"))
    else:
        figures += torch_figures(device, at_a_time, repeats)
    answer("Contacts per second", figures, json)


def torch_figures(device: str, at_a_time: tuple[int, ...], repeats: int) -> list[Figure]:
    """Batches on one device."""
    import torch

    there = torch.cuda.is_available()
    device = device or ("cuda" if there else "cpu")
    torch.set_num_threads(1)
    name = torch.cuda.get_device_name(device) if device.startswith("cuda") else "CPU, 1 thread"
    if not there:
        name += " (torch sees no GPU here: these are no figures of a GPU)"
    like = torch.zeros((), dtype=torch.float32, device=device)
    draw = BatchRenderer(TWIN.renderer, like).pictures
    figures = [Figure("device", f"{name}, torch {torch.__version__}")]
    for count in at_a_time:
        touches = [Touch.some(count, 0)]
        figures.append(Figure(f"{count} at a time, contacts per s", per_second(like, touches, repeats)))
        drawn = per_second(like, touches, repeats, draw)
        goal = at_least(f"{count} at a time, drawn, per s", drawn, WANTED_PER_S, "per s")
        figures.append(goal if there else Figure(f"{count} at a time, drawn, per s", drawn))
    return figures


@dataclass(frozen=True)
class Touch:
    """Contacts to be made at once."""

    pressed: Pose
    dragged: Pose

    @staticmethod
    def some(count: int, seed: int) -> "Touch":
        """A batch of this many; one is no batch."""
        x, y, depth, by_x, by_y, twist = np.random.default_rng(seed).uniform(
            [[-8], [-6], [0.3], [-0.5], [-0.5], [-0.2]], [[8], [6], [1.5], [0.5], [0.5], [0.2]], (6, count)
        )
        pressed, dragged = Pose(x, y, depth), Pose(x + by_x, y + by_y, depth, twist)
        return Touch(pressed, dragged) if count > 1 else Touch(pressed.each()[0], dragged.each()[0])


def per_second(
    like: Any, touches: list[Touch], repeats: int, draw: Callable[[Contact], object] = lambda contact: None
) -> float:
    """Steps solved (and drawn) per second, the best of some repeats after one that does not count."""
    model = ContactModel(gel_skin(PATCH, Gel(), like), effort=EFFORT)
    seconds = []
    for _ in range(repeats + 1):
        start = perf_counter()
        for touch in touches:
            for contact in model.follow(BALL, [touch.pressed, touch.dragged]):
                draw(contact)
            waited_for(contact)
        seconds.append(perf_counter() - start)
    steps = 2 * sum(int(np.prod(touch.pressed.batch_shape)) for touch in touches)
    return steps / min(seconds[1:])


def waited_for(contact: Contact) -> None:
    """Nothing of the work is left to the device."""
    float(contact.height_mm.sum())


if __name__ == "__main__":
    tyro.cli(gpu_contacts)

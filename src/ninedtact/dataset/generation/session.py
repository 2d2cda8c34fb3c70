"""A session of the data generation: some fifty pairs with one simulated sensor (no contact, light touches, scripted presses)."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

from ninedtact.capture.training_pair_rule import SamplingRule
from ninedtact.dataset.generation.press_trajectory import SimulatedPressTrajectory
from ninedtact.dataset.generation.settings import GenerationImpossible, GenerationSettings
from ninedtact.dataset.schema import NO_OBJECT, DatasetRow
from ninedtact.dataset.stored_images import encode_png
from ninedtact.mechanics.indenter import Indenter
from ninedtact.simulation.batched.session_requests import (
    ContactSummary,
    RenderRequest,
    RequestGenerator,
    SimulatedSetup,
)
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.rectified_renderer import rectified_mm_per_px, rectified_renderer

_STEP_NS = 100_000_000
"""Time between two steps of a press: ten a second."""
_LIGHTEST_N = 0.02
_MAX_FRUITLESS_PRESSES = 30
"""Number of consecutive presses without a pair after which the session is abandoned."""
_OBJECT_SHIFT = 7
"""Shift of each session's first object in the shuffled list: about as many presses as a session makes."""


@dataclass
class GenerationSession:
    """Session `number` of a data set.

    Its pairs depend neither on which other sessions are made nor on which executor computes its requests.
    """

    number: int
    settings: GenerationSettings
    setup: SimulatedSetup
    rows: list[DatasetRow] = field(default_factory=list, init=False)
    """The pairs so far."""
    _presses: int = field(default=0, init=False)
    _steps: int = field(default=0, init=False)

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng([self.settings.seed, 1, self.number])
        self._rule = SamplingRule(self.settings.rule, self._rng)
        self._missing = _session_quotas(self.number, self.settings)

    def requests(self) -> RequestGenerator[list[DatasetRow]]:
        """Yield the session's requests; the result is its pairs. Raises `GenerationImpossible` where presses give no pairs."""
        objects = _session_objects(self.settings, self.number)
        fruitless = 0
        while any(self._missing.values()):
            before = len(self.rows)
            yield from self._press_once(next(objects))
            fruitless = fruitless + 1 if len(self.rows) == before else 0
            if fruitless > _MAX_FRUITLESS_PRESSES:
                raise GenerationImpossible(
                    f"expected pairs from presses, got none from {_MAX_FRUITLESS_PRESSES} of them; press harder, or loosen the rule"
                )
        return self.rows

    def _press_once(self, object_name: str) -> RequestGenerator[None]:
        """Add a pair of every kind that is still missing: without contact, of a light touch, and of one press."""
        self._presses += 1
        if self._missing["no_contact"]:
            yield from self._add_row(None, NO_OBJECT, "no_contact")
        if self._missing["light_touch"]:
            press = self._start_press(object_name)
            load_n = float(self._rng.uniform(_LIGHTEST_N, self.settings.light_below_n))
            contact = yield from press.press_lightly(load_n)
            if contact and -self.settings.light_below_n < contact.wrench.force_n[2] < 0:
                yield from self._add_row(contact, object_name, "light_touch")
        if self._missing["rule"]:
            self._presses += 1
            yield from self._add_selected_rows(object_name)

    def _add_selected_rows(self, object_name: str) -> RequestGenerator[None]:
        """Add what the sampling rule selects of one press."""
        self._rule.end_contact()
        press = self._start_press(object_name)
        for target in press.targets():
            contact = yield from press.step_towards(target)
            if contact is None:
                return
            self._steps += 1
            if self._rule.keeps(contact.wrench):
                yield from self._add_row(contact, object_name, "rule")
            if not self._missing["rule"]:
                return

    def _start_press(self, object_name: str) -> SimulatedPressTrajectory:
        indenter = load_object(object_name, self.settings.objects_seed)
        return SimulatedPressTrajectory(self.setup, indenter, self.settings.press, self._rng)

    def _add_row(self, contact: ContactSummary | None, object_name: str, kind: str) -> RequestGenerator[None]:
        """Request an image of the contact and add it with its wrench."""
        self._missing[kind] -= 1
        wrench = contact.wrench.six if contact else np.zeros(6)
        factor = yield RenderRequest(self.setup, contact.corrected if contact else None)
        image = self.setup.renderer.add_noise(factor, self._rng)
        sensor = self.setup.member.name
        self.rows.append(
            DatasetRow(
                id=self._row_id(len(self.rows)),
                image=encode_png(image),
                reference_id=sensor,
                wrench=wrench.astype(np.float32),
                object=object_name,
                contact_id=f"{self.number:05d}-{self._presses:03d}",
                step=self._steps,
                time_ns=self._steps * _STEP_NS,
                sensor=sensor,
                kind=kind,
                source=None,
                mm_per_px=rectified_mm_per_px(self.settings.size, self.settings.design),
            )
        )

    def _row_id(self, index: int) -> str:
        """Return the id of a row of this session: the numbers of its file and of its row there."""
        file, session_in_file = divmod(self.number, self.settings.sessions_per_file)
        return f"train-{file:05d}-{session_in_file * self.settings.pairs_per_session + index:05d}"


def make_setup(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, ready for contact steps and renders."""
    parameters = settings.sensor_parameters(number)
    return SimulatedSetup(parameters, parameters.twin(settings.pitch_mm), rectified_renderer(parameters, settings.size))


@lru_cache(maxsize=2)
def cached_setup(number: int, settings: GenerationSettings) -> SimulatedSetup:
    """Return the simulated sensor of this number, kept while the next one is in use."""
    return make_setup(number, settings)


@lru_cache(maxsize=64)
def load_object(name: str, seed: int) -> Indenter:
    """Return the object of this name, made once; raises `UnknownObject`."""
    return indenter_from_name(name, seed)


def _session_objects(settings: GenerationSettings, session: int) -> Iterator[str]:
    """Yield names of objects for one session without end; over all sessions all objects come equally often."""
    names = settings.selected_objects
    order = np.random.default_rng([settings.seed, 2]).permutation(len(names))
    at = session * _OBJECT_SHIFT
    while True:
        yield names[order[at % len(names)]]
        at += 1


def _session_quotas(number: int, settings: GenerationSettings) -> dict[str, int]:
    """Return how many pairs of each kind a session makes, such that the shares hold over all sessions."""
    first = number * settings.pairs_per_session
    end = min(first + settings.pairs_per_session, settings.pairs)
    shares = {"no_contact": settings.shares.no_contact, "light_touch": settings.shares.light_touch}
    counts = {kind: round(share * end) - round(share * first) for kind, share in shares.items()}
    others = min(sum(counts.values()), end - first)
    return {**counts, "rule": end - first - others}

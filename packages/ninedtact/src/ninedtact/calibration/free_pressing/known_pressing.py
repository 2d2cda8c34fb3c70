"""Contacts of free pressing as presses with known loads, with the shear factor, and what both gain on contacts that were left out.

Every image is estimated once, which aligns the force/torque sensor with the skin. A few moments of each contact, at its largest
load, half way to it and at its largest shear, are then estimated on all assumed bases: with the aligned load of the force/torque
sensor they are presses like those on a scale (`gel_fit_to_known_loads`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.interpolate import PchipInterpolator

from ninedtact.calibration.free_pressing.force_torque_alignment import (
    Alignment,
    EstimatedMoments,
    fit_alignment,
)
from ninedtact.calibration.free_pressing.pressing import ForceTorqueSamples, FreePressing, PressingUnusable
from ninedtact.calibration.gel_fit_to_known_loads import (
    AssumedBases,
    KnownLoadFit,
    KnownLoadPress,
    find_contradiction,
    fit_agreeing_loads,
)
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.force.estimator_and_scale import SHEAR_COMPONENTS, ForceEstimator
from ninedtact.quantities import EstimateWarning
from ninedtact.reading import Reading

_LEAST_CONTACTS = 3
_MOST_CONTACTS = 20
"""Contacts that are estimated on all bases."""
_HALF = 0.5
"""Part of the largest load of a contact at which its second moment is taken."""
_LEAST_LOAD_N = 0.3
"""Load below which a moment tells more of noise than of the gel."""
_SHEARED_STD = 0.5
"""Relative error of the estimated load of a dragged contact, per ratio of its shear to its load."""
_LEAST_WEIGHT = 0.25
"""Weight in the alignment below which a contact contradicts the others."""
_SAMPLE_STD_N = 0.03
_SHEAR_PRIOR_STD = 0.25
_FOLDS = 5


@dataclass(frozen=True)
class PressedMoment:
    """A moment of a contact that is estimated on all assumed bases."""

    name: str
    at_s: float
    contact: int
    reading: Reading
    six: Float[Array, "bases 6"]
    """The wrench about the skin's centre on each base."""
    covariance: Float[Array, "6 6"]
    """Of the estimate on the calibrated base."""
    warnings: tuple[EstimateWarning, ...]
    siblings: int
    """Number of such moments of its contact."""


@dataclass(frozen=True)
class KeptOutErrors:
    """The errors of forces of contacts that took no part in the fit, before and after it."""

    skill_before: tuple[float, ...]
    """1 − MAE ÷ (MAE of always stating the median), for each component of the wrench."""
    skill_after: tuple[float, ...]
    mae_before: tuple[float, ...]
    """Mean absolute error, N and N·m."""
    mae_after: tuple[float, ...]
    moments: int


class KnownPressing:
    """Free pressing, estimated and aligned."""

    def __init__(
        self, pressing: FreePressing, sensor: SensorFolder, estimators: Sequence[ForceEstimator], bases: AssumedBases
    ) -> None:
        """sensor: as its images calibrated it. estimators: one for each of the bases. Raises `PressingUnusable` and what reading
        raises.
        """
        self.bases, self.name, self.notices = bases, pressing.name, list(pressing.notices)
        self.samples, self.mount = pressing.samples, pressing.mount
        middle = bases.ratios.index(bases.mean) if bases.is_searched else 0
        self._middle = middle
        self.moments = _estimate_moments(pressing, sensor, estimators[middle])
        known = np.isfinite(self.samples.at(self.moments.at_s)[:, 0])
        contacts = np.unique(self.moments.group[known & (self.moments.group >= 0)])
        if len(contacts) < _LEAST_CONTACTS:
            raise PressingUnusable(
                expected=f"at least {_LEAST_CONTACTS} contacts with samples of the force/torque sensor in {self.name}",
                got=f"{len(contacts) or 'none'}" + "".join(f"; {notice}" for notice in self.notices),
                remedy="press the skin more often, and let go in between",
            )
        self.alignment = fit_alignment(self.moments, self.samples, self.mount)
        self.pressed = self._estimate_on_bases(pressing, sensor, estimators)
        self.contacts = len(contacts)
        for contact, weight in self.alignment.weights.items():
            if weight < _LEAST_WEIGHT:
                self._leave_out(
                    contact, "its forces have another direction or size than those of the force/torque sensor"
                )

    @property
    def readings(self) -> dict[str, Reading]:
        """The readings of the presses with known loads, by their names."""
        return {moment.name: moment.reading for moment in self.pressed}

    def presses(self, others: Sequence[KnownLoadPress] = ()) -> list[KnownLoadPress]:
        """Return the presses with known loads that agree with each other and with others, such as those on a scale.

        A contact that contradicts them is left out from now on, and a notice names it. Raises `PressingUnusable` where that leaves
        too few.
        """
        while True:
            presses = _known_loads(self.pressed, self.alignment, self.samples, self._middle)
            if len({self._contact_of(press) for press in presses}) < _LEAST_CONTACTS:
                raise PressingUnusable(
                    expected=f"at least {_LEAST_CONTACTS} contacts of {_LEAST_LOAD_N:g} N or more that agree with each other",
                    got=f"{len(presses)} usable moments in {self.name}" + "".join(f"; {each}" for each in self.notices),
                    remedy="press the skin more often, and harder",
                )
            everything = [*others, *presses]
            worst = find_contradiction(everything, self.bases)
            if worst is None or worst < len(others):
                return presses
            press = everything[worst]
            fit = fit_agreeing_loads(everything, self.bases)
            self._leave_out(
                self._contact_of(press),
                f"{press.weighed_n:.2f} N at {press.name} where the others say {fit.estimated_n[worst]:.2f} N",
            )

    def with_shear(self, fit: KnownLoadFit) -> KnownLoadFit:
        """Return the fit with the shear factor that this pressing tells."""
        return _fit_shear(fit, self.pressed, self.bases, self.alignment, self.samples)

    def kept_out_errors(self, others: Sequence[KnownLoadPress] = ()) -> KeptOutErrors:
        """Return the errors of contacts as the others, and other presses, predict them; their alignment is found without them."""
        contacts = sorted({moment.contact for moment in self.pressed})
        truths, befores, afters = [], [], []
        for fold in range(min(_FOLDS, len(contacts))):
            kept_out = contacts[fold::_FOLDS]
            train = self.moments.select(~np.isin(self.moments.group, kept_out))
            alignment = fit_alignment(train, self.samples, self.mount, self.alignment)
            taught = [moment for moment in self.pressed if moment.contact not in kept_out]
            fit = fit_agreeing_loads(
                [*others, *_known_loads(taught, alignment, self.samples, self._middle)], self.bases
            )
            fit = _fit_shear(fit, taught, self.bases, alignment, self.samples)
            for moment in (moment for moment in self.pressed if moment.contact in kept_out):
                truths.append(_true_six(moment, alignment, self.samples))
                befores.append(moment.six[self._middle])
                factors = fit.factor * np.where(SHEAR_COMPONENTS, fit.shear_factor, 1.0)
                afters.append(_six_on_base(moment, self.bases, fit.ratio) * factors)
        true, before, after = map(np.array, (truths, befores, afters))
        spread = np.abs(true - np.median(true, axis=0)).mean(axis=0)
        mae = [np.abs(found - true).mean(axis=0) for found in (before, after)]
        skills = [1 - each / np.maximum(spread, 1e-12) for each in mae]
        values = [tuple(each.tolist()) for each in (*skills, *mae)]
        return KeptOutErrors(values[0], values[1], values[2], values[3], len(true))

    def _leave_out(self, contact: int, reason: str) -> None:
        at_s = self.moments.at_s[self.moments.group == contact]
        self.notices.append(f"the contact from {at_s[0]:.1f} to {at_s[-1]:.1f} s is left out: {reason}")
        self.pressed = [moment for moment in self.pressed if moment.contact != contact]

    def _contact_of(self, press: KnownLoadPress) -> int:
        return next(moment.contact for moment in self.pressed if moment.name == press.name)

    def _estimate_on_bases(
        self, pressing: FreePressing, sensor: SensorFolder, estimators: Sequence[ForceEstimator]
    ) -> list[PressedMoment]:
        """Return the chosen moments, estimated on all bases."""
        found = []
        for number, siblings in _choose_moments(self.moments, self.samples, self.alignment):
            reading, estimates = pressing.read(number, sensor), []
            for estimator in estimators:
                estimator.forget()
                estimates.append(estimator.estimate(reading).about_skin_centre())
            own, at_s = estimates[self._middle], float(self.moments.at_s[number])
            found.append(
                PressedMoment(
                    f"{self.name} at {at_s:.2f} s",
                    at_s,
                    int(self.moments.group[number]),
                    reading,
                    np.array([estimate.wrench.six for estimate in estimates]),
                    own.covariance,
                    own.warnings,
                    siblings,
                )
            )
        return found


def _estimate_moments(pressing: FreePressing, sensor: SensorFolder, estimator: ForceEstimator) -> EstimatedMoments:
    """Return the wrenches of all images, each estimated alone, and the contacts to which they belong."""
    six, covariances, touching = [], [], []
    for number in range(len(pressing.stamps_ns)):
        estimator.forget()
        estimate = estimator.estimate(pressing.read(number, sensor)).about_skin_centre()
        six.append(estimate.wrench.six)
        covariances.append(estimate.covariance)
        touching.append(estimate.touching)
    at_s = (pressing.stamps_ns - pressing.stamps_ns[0]) / 1e9
    return EstimatedMoments(at_s, _group_contacts(np.array(touching)), np.array(six), np.array(covariances))


def _group_contacts(touching: Bool[Array, " n"]) -> Array:
    """Return the number of each contact, and −1 and below for the times between."""
    begins = np.concatenate([[True], touching[1:] != touching[:-1]])
    number = np.cumsum(begins) - 1
    return np.where(touching, number, -1 - number)


def _choose_moments(
    moments: EstimatedMoments, samples: ForceTorqueSamples, alignment: Alignment
) -> list[tuple[int, int]]:
    """Return the numbers of the moments at which contacts are compared in detail, and how many such moments its contact has.

    Where there are many contacts, those of evenly distributed loads are taken.
    """
    load_n, shear_n = -moments.six[:, 2], np.hypot(*moments.six[:, :2].T)
    usable = np.isfinite(samples.at(moments.at_s + alignment.delay_s)[:, 0]) & np.isfinite(moments.covariance).all(
        (1, 2)
    )
    usable &= (moments.group >= 0) & (load_n * alignment.factor >= _LEAST_LOAD_N)
    of_contacts = []
    for contact in np.unique(moments.group[usable]):
        own = np.flatnonzero(usable & (moments.group == contact))
        deepest = own[(load_n[own] * np.exp(-shear_n[own] / load_n[own])).argmax()]
        half = own[np.abs(load_n[own] - _HALF * load_n[deepest]).argmin()]
        of_contacts.append(sorted({int(deepest), int(half), int(own[shear_n[own].argmax()])}))
    of_contacts.sort(key=lambda own: float(load_n[own].max()))
    if len(of_contacts) > _MOST_CONTACTS:
        of_contacts = [of_contacts[each] for each in np.linspace(0, len(of_contacts) - 1, _MOST_CONTACTS).astype(int)]
    return sorted((number, len(own)) for own in of_contacts for number in own)


def _true_six(moment: PressedMoment, alignment: Alignment, samples: ForceTorqueSamples) -> Float[Array, "6"]:
    """Return the wrench on the skin that the force/torque sensor measured."""
    return alignment.wrench_on_skin(np.array([moment.at_s]), samples)[0]


def _known_loads(
    pressed: Sequence[PressedMoment], alignment: Alignment, samples: ForceTorqueSamples, middle: int
) -> list[KnownLoadPress]:
    """Return the moments with their aligned loads; those whose load is too small are left out."""
    found = []
    for moment in pressed:
        six = _true_six(moment, alignment, samples)
        load_n = -float(six[2])
        if not (load_n >= _LEAST_LOAD_N and (moment.six[:, 2] < 0).all()):
            continue
        stated = float(np.sqrt(moment.covariance[2, 2])) / -float(moment.six[middle, 2])
        parts = [stated, _SAMPLE_STD_N / load_n, _SHEARED_STD * float(np.hypot(*six[:2])) / load_n]
        relative = float(np.linalg.norm(parts) * np.sqrt(moment.siblings))
        loads = tuple((-moment.six[:, 2]).tolist())
        found.append(KnownLoadPress(moment.name, load_n, loads, relative, middle, moment.warnings))
    return found


def _six_on_base(moment: PressedMoment, bases: AssumedBases, ratio: float) -> Float[Array, "6"]:
    """Return the estimated wrench on a base between the assumed ones."""
    return np.asarray(PchipInterpolator(bases.ratios, moment.six)(ratio)) if bases.is_searched else moment.six[0]


def _fit_shear(
    fit: KnownLoadFit,
    pressed: Sequence[PressedMoment],
    bases: AssumedBases,
    alignment: Alignment,
    samples: ForceTorqueSamples,
) -> KnownLoadFit:
    """Return the fit with the shear factor s that explains F_x and F_y, by Gauss–Newton on true = s · estimated, both with errors.

    What the pressing does not tell keeps s = 1 ± 0.25.
    """
    true = np.array([_true_six(moment, alignment, samples) for moment in pressed])
    estimated = np.array([fit.factor * _six_on_base(moment, bases, fit.ratio)[:2] for moment in pressed])
    covariance = np.array([fit.factor**2 * moment.covariance[:2, :2] for moment in pressed])
    siblings = np.array([moment.siblings for moment in pressed])
    tilt = float(alignment.std[6:].max())
    noise = np.eye(2) * (_SAMPLE_STD_N**2 + (tilt * true[:, 2]) ** 2)[:, None, None]
    factor, excess = 1.0, 1.0
    for _ in range(20):
        precision = np.linalg.inv(factor**2 * covariance + noise)
        off = true[:, :2] - factor * estimated
        weighted = (precision @ off[:, :, None])[:, :, 0]
        agreed = estimated + factor * (covariance @ weighted[:, :, None])[:, :, 0]
        excess = max(1.0, float((off * weighted).sum() / off.size))
        information = np.einsum("ni,nij,nj->n", agreed, precision, agreed) / siblings / excess
        gain = np.einsum("ni,ni->n", agreed, weighted) / siblings / excess
        total = information.sum() + _SHEAR_PRIOR_STD**-2
        step = (gain.sum() - (factor - 1) * _SHEAR_PRIOR_STD**-2) / total
        factor = float(np.clip(factor + step, 0.25, 4.0))
    return replace(fit, shear_factor=factor, shear_std=float(min(total**-0.5 / factor, 1.0)))

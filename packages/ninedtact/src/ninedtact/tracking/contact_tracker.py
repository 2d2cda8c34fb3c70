"""Contacts, motion of the object and slip, followed from image to image.

How far the object has moved comes from its shape where that shows it (`ObjectTracker`), otherwise from the centre of a contact that
is convex, as of balls, and from the edges of others (`ImprintShift`).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from ninedtact.quantities import HeightMap, Traction, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.shape.contacts import ContactPatch
from ninedtact.tracking.carried_shear import CarriedSkin
from ninedtact.tracking.contact_follower import ContactFollower
from ninedtact.tracking.imprint_shift import ImprintShift
from ninedtact.tracking.object_tracker import ObjectMotion, ObjectTracker
from ninedtact.tracking.sliding_load import as_it_slides, overread_of_sliding
from ninedtact.tracking.sliding_springs import SlipSample
from ninedtact.tracking.slip import SlipEstimate, SlipEstimator, SlipState

_SEEN_STD_MM = 0.06
"""Standard deviation of a position up to which the object's shape shows its motion along the skin."""
_CONVEX = 0.93
"""Share of its convex hull that a contact covers from which its centre is that of the object."""
_UNLIKELY_MM = 0.6
"""Difference between the steps by edges and by centres from which edges are mistaken."""
CONTACT_CENTRE_STD_MM = 0.012
"""Error of the motion of a contact's centre between images, found on simulated sensors."""
_EVEN_PITCH_MM = 0.6
"""Pitch of the cells over which a load is spread where no traction was recorded."""
_LEAST_FRICTION = 0.1
"""Friction coefficient that dry objects on silicone exceed."""
_LOAD_STD_N, _RELATIVE_LOAD_STD = 0.004, 0.004
"""Error of loads between images, found on simulated sensors."""


@dataclass(frozen=True)
class TrackedContacts:
    """What touches in one reading."""

    reading: Reading
    """Where the turn of the object is seen, its wrench has the torque about z that this tells."""
    contacts: tuple[ContactPatch, ...]
    """The contacts, each with the number by which it is followed; the largest first."""
    motion: ObjectMotion
    """Motion of the object since it touched first, if all contacts belong to one object."""
    displacement_mm: Float[Array, "2"]
    """How far the object has moved along the skin since the stream began, by its shape or by its contacts' centres."""
    slip: SlipEstimate
    """Slip of all contacts together; unknown without a force estimator."""
    slips: tuple[SlipEstimate, ...]
    """Slip of each contact."""


@dataclass
class ContactTracker:
    """Follows contacts, object and slip through the readings of a sensor.

    >>> tracker = ninedtact.tracking.ContactTracker()
    >>> with ninedtact.open("my_sensor", source="sim") as sensor:
    ...     states = [found.slip.state for found, _ in zip(tracker.follow(sensor), range(50))]
    """

    objects: ObjectTracker = field(default_factory=ObjectTracker)
    slip: SlipEstimator = field(default_factory=lambda: SlipEstimator(least_friction=_LEAST_FRICTION))
    carried: CarriedSkin = field(default_factory=CarriedSkin)
    _followed: ContactFollower = field(default_factory=ContactFollower, init=False, repr=False)
    _slips: dict[int, SlipEstimator] = field(default_factory=dict, init=False, repr=False)
    """Estimators of single contacts, by their numbers, where there are several."""
    _is_turned: bool = field(default=False, init=False, repr=False)
    """Whether the skin under the object tells what sticks."""
    _moved_mm: Float[Array, "2"] = field(default_factory=lambda: np.zeros(2), init=False, repr=False)
    _imprint: ImprintShift = field(default_factory=ImprintShift, init=False, repr=False)
    _last: TrackedContacts | None = field(default=None, init=False, repr=False)

    def follow(self, readings: Iterable[Reading]) -> Iterator[TrackedContacts]:
        """Yield what touches in every reading of a stream, such as an open sensor."""
        return map(self.update, readings)

    def update(self, reading: Reading) -> TrackedContacts:
        """Return what touches in the next reading of the stream; slip is unknown in one that is not later."""
        contacts = () if reading.image_warnings else self._followed.update(reading.contacts)
        motion = self.objects.update(reading)
        self._moved_mm = self._moved_mm + self._step_mm(contacts, motion, reading.height)
        slip, slips = SlipEstimate(), tuple(SlipEstimate() for _ in contacts)
        if not reading.is_touching and not reading.image_warnings:
            slip, self._slips, self._is_turned = self.slip.release(), {}, False
            self.carried.release()
        elif contacts and reading.force is not None:
            traction = _traction(reading)
            overread = overread_of_sliding(traction)
            slip, force = self._slip_and_force(reading, motion, reading.force, traction, overread)
            slips = self._slips_of(reading, contacts, overread) if len(contacts) > 1 else (slip,)
            if len(contacts) == 1 and contacts[0].force is not None:
                contacts = (replace(contacts[0], force=force),)
            reading = reading.with_force(force)
        self._last = TrackedContacts(reading, contacts, motion, self._moved_mm, slip, slips)
        return self._last

    def _step_mm(
        self, contacts: tuple[ContactPatch, ...], motion: ObjectMotion, height: HeightMap
    ) -> Float[Array, "2"]:
        """Return how far the object has moved along the skin since the image before."""
        if self._last is None:
            return np.zeros(2)
        before = self._last.motion
        if _shows_motion(before) and _shows_motion(motion) and before.path == motion.path:
            return motion.moved_mm[:2] - before.moved_mm[:2]
        centres = {contact.number: contact.centre_mm for contact in self._last.contacts}
        pairs = [(one.area_mm2, one.centre_mm - centres[one.number]) for one in contacts if one.number in centres]
        if not pairs:
            return np.zeros(2)
        areas, steps = zip(*pairs, strict=True)
        step_mm = np.asarray(np.average(steps, axis=0, weights=areas))
        if min(contact.convexity for contact in contacts) >= _CONVEX:
            return step_mm
        imprint_step_mm = self._imprint.update(self._last.reading.height, height)
        # Edges of one part may be matched with those of another.
        agrees = float(np.linalg.norm(imprint_step_mm - step_mm)) < _UNLIKELY_MM
        return imprint_step_mm if agrees else step_mm

    def _slip_and_force(
        self, reading: Reading, motion: ObjectMotion, force: WrenchEstimate, traction: Traction, overread: float
    ) -> tuple[SlipEstimate, WrenchEstimate]:
        """Return the slip of all contacts together, and the wrench: with the load of a contact that slides where all of it does.

        Once the object turned more than it was dragged, the skin under it tells what sticks, as springs know nothing of the turn;
        they still tell when all slides.
        """
        carried = self.carried.update(motion, traction, force.wrench.force_n[:2], self.slip.friction)
        if carried is not None and carried.is_turn_under(float(np.hypot(*force.wrench.force_n[:2]))):
            slip, self._is_turned = self.slip.release(), True
        else:
            slip = _slip_at(self.slip, reading, self._moved_mm, force.wrench, overread)
        if slip.state == SlipState.GROSS:
            force, self._is_turned = as_it_slides(force, overread), False
        elif carried is not None and self._is_turned:
            slip = replace(
                slip,
                state=SlipState.INCIPIENT if carried.p_incipient > 0.5 else SlipState.STATIC,
                p_incipient=carried.p_incipient,
                p_gross=0.0,
                sticking_share=carried.sticking_share,
                speed=0.0,
            )
        return slip, force if carried is None else carried.correct(force)

    def _slips_of(
        self, reading: Reading, contacts: tuple[ContactPatch, ...], overread: float
    ) -> tuple[SlipEstimate, ...]:
        """Return the slip of each of several contacts, by its own share of the load and its own centre."""
        self._slips = {
            one.number: self._slips.get(one.number, SlipEstimator(least_friction=_LEAST_FRICTION)) for one in contacts
        }
        return tuple(
            SlipEstimate()
            if one.force is None
            else _slip_at(self._slips[one.number], reading, one.centre_mm, one.force.wrench, overread)
            for one in contacts
        )


def _shows_motion(motion: ObjectMotion) -> bool:
    """Return whether the object's shape shows its motion along the skin."""
    return motion.is_known and bool(motion.std[:2].max() < _SEEN_STD_MM)


def _traction(reading: Reading) -> Traction:
    """Return the traction of a reading; where only the wrench was recorded, its load spread evenly over what touches."""
    force = reading.force
    assert force is not None
    if force.traction is not None:
        return force.traction
    height = reading.height
    rows, cols = (max(round(side * height.mm_per_px / _EVEN_PITCH_MM), 1) for side in reading.contact.shape)
    touched = cv2.resize(reading.contact.astype(np.float32), (cols, rows), interpolation=cv2.INTER_AREA)
    pitch_mm = height.mm_per_px * reading.contact.shape[1] / cols
    load_mpa = max(-float(force.wrench.force_n[2]), 0.0) / max(float(touched.sum()) * pitch_mm**2, 1e-12)
    return Traction(np.float32(load_mpa) * touched, np.zeros((2, rows, cols), np.float32), pitch_mm)


def _slip_at(
    estimator: SlipEstimator, reading: Reading, displacement_mm: Float[Array, "2"], wrench: Wrench, overread: float
) -> SlipEstimate:
    """Return the slip of an object at a displacement under a load."""
    if estimator.time_s is not None and reading.stamp_ns / 1e9 <= estimator.time_s:
        return SlipEstimate()  # a damaged recording repeats stamps
    normal_n = -float(wrench.force_n[2])
    sample = SlipSample(
        reading.stamp_ns / 1e9,
        displacement_mm,
        wrench.force_n[:2],
        normal_n,
        CONTACT_CENTRE_STD_MM,
        load_std_n(normal_n),
        overread,
    )
    return estimator.update(sample)


def load_std_n(normal_n: float) -> float:
    """Return the error of loads that changes from image to image; that of the gel's stiffness is common to all loads."""
    return _LOAD_STD_N + _RELATIVE_LOAD_STD * abs(normal_n)

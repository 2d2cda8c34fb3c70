"""A reference image that follows slow changes: an hour of drifting light, a long press, and gel that creeps after it."""

import numpy as np
import pytest
from small_sensor import SHAPE, skin

from ninedtact.force.contact_detection import detect_contact
from ninedtact.quantities import Frame, HeightMap, HeightSource, Rectified, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.reference_images import FollowingSettings, ReferenceFollower, ReferenceImages

ROWS, COLS, MM_PER_PX = 86, 115, 0.209
Y, X = np.mgrid[0:ROWS, 0:COLS].astype(np.float32)
SKIN = (140 + 20 * np.cos(X / 40) + 15 * np.sin(Y / 30)).astype(np.float32)
DENT = np.exp(-((X - 60) ** 2 + (Y - 40) ** 2) / 2 / 8**2).astype(np.float32)
HOUR_S = 3600
PRESSED_S = range(1200, 1500)
SETTLED_S = 120.0
"""Time after the release from which no contact may be detected."""


def image_at(second: int, rng: np.random.Generator) -> np.ndarray:
    """LEDs that warm up by 3 %, unevenly; a press of five minutes; an imprint of 4 % of it that fades within half a minute."""
    warm = 1 - np.exp(-second / 1500)
    light = 1 - 0.03 * warm * (1 + 0.5 * X / COLS)
    dent = 0.2 if second in PRESSED_S else 0.0
    if second >= PRESSED_S.stop:
        dent = 0.2 * 0.04 * np.exp(-(second - PRESSED_S.stop) / 12)
    return np.asarray(SKIN * light * (1 - dent * DENT) + rng.normal(0, 0.3, SKIN.shape), np.float32)


def reading_of(grey: np.ndarray, reference: Rectified, second: int) -> Reading:
    flat = np.zeros((ROWS, COLS), np.float32)
    source = np.full((ROWS, COLS), HeightSource.MEASURED, np.uint8)
    stamp_ns = second * 1_000_000_000
    frame = Frame(np.zeros((2, 2, 3), np.uint8), stamp_ns, second)
    return Reading(frame, Rectified(grey, MM_PER_PX), HeightMap(flat, source, MM_PER_PX), reference=reference)


def false_contacts(settings: FollowingSettings | None, every_s: int = 1) -> tuple[int, int, float]:
    """Return how often contact is detected while nothing touches, how often it is overlooked, and the drift that was followed."""
    rng = np.random.default_rng(5)
    taken = Rectified(np.mean([image_at(0, rng) for _ in range(10)], axis=0).astype(np.float32), MM_PER_PX)
    follower = None if settings is None else ReferenceFollower(taken, settings)
    reference, false, overlooked = taken, 0, 0
    for second in range(0, HOUR_S, every_s):
        reading = reading_of(image_at(second, rng), reference, second)
        touching = detect_contact(reading)
        overlooked += second in PRESSED_S and not touching
        released_s = second - PRESSED_S.stop
        false += touching and second not in PRESSED_S and not 0 <= released_s < SETTLED_S
        if follower is not None:
            reference = follower.follow(reading) or reference
    return false, overlooked, 0.0 if follower is None else follower.drift


def test_zero_stays_zero_for_an_hour_with_following_and_does_not_without() -> None:
    false, overlooked, drift = false_contacts(FollowingSettings())
    assert (false, overlooked) == (0, 0)
    true_drift = image_at(HOUR_S, np.random.default_rng(1)).mean() / SKIN.mean() - 1
    assert drift == pytest.approx(true_drift, abs=2e-3)
    assert false_contacts(None, every_s=10)[0] > HOUR_S / 10 / 4


def test_it_never_follows_under_contact_nor_beyond_its_bound() -> None:
    taken = Rectified(SKIN, MM_PER_PX)
    follower = ReferenceFollower(taken, FollowingSettings(rest_s=5.0))
    for second in range(100):
        pressed = reading_of(SKIN * (1 - 0.2 * DENT), taken, second)
        assert detect_contact(pressed) and follower.follow(pressed) is None
    assert follower.follow(reading_of(SKIN, taken, 103)) is None  # it rests for five seconds after a contact
    reference = taken
    for second in range(200, 1200):
        reference = follower.follow(reading_of(SKIN * np.float32(0.9), reference, second)) or reference
    assert follower.drift == pytest.approx(-0.1, abs=1e-3)  # the gain of the whole has no bound
    for second in range(1200, 1400):
        bulge = SKIN * np.float32(0.9) * (1 + 0.1 * DENT).astype(np.float32)
        reference = follower.follow(reading_of(bulge, reference, second)) or reference
    assert (reference.grey / (0.9 * SKIN)).max() == pytest.approx(1.05, abs=2e-3)


def test_an_image_that_is_no_press_is_not_followed() -> None:
    taken = Rectified(SKIN, MM_PER_PX)
    follower = ReferenceFollower(taken)
    black = reading_of(np.zeros_like(SKIN), taken, 1)
    assert black.image_warnings and follower.follow(black) is None


def test_the_error_of_settling_gel_decays_after_a_release() -> None:
    taken = Rectified(SKIN, MM_PER_PX)
    settings = FollowingSettings(settling=0.05, settling_s=10.0)
    follower = ReferenceFollower(taken, settings)
    wrench = Wrench(np.array([0.0, 1.0, -8.0]), np.zeros(3), stamp_ns=0)
    touched = WrenchEstimate(wrench, np.eye(6), touching=True)
    follower.follow(reading_of(SKIN * (1 - 0.2 * DENT), taken, 0).with_force(touched))
    stds = []
    for second in (1, 11, 200):
        nothing = WrenchEstimate(
            Wrench(np.zeros(3), np.zeros(3), stamp_ns=second * 1_000_000_000), 1e-4 * np.eye(6), touching=False
        )
        stds.append(follower.with_settling_error(nothing).std[2])
    expected = [np.hypot(0.01, 0.05 * 8 * np.exp(-second / 10)) for second in (1, 11, 200)]
    np.testing.assert_allclose(stds, expected, rtol=1e-6)
    assert follower.with_settling_error(touched) is touched


def test_what_replaces_a_reference_depends_on_the_stamp_and_on_what_was_taken() -> None:
    given, first, second, at_7 = (SHAPE.depth_reader(Frame(skin(100), number)) for number in range(4))
    references = ReferenceImages(given, lambda stamp_ns: first if stamp_ns < 5 else second, [(7, at_7)])
    assert references.in_use is given
    changes = [references.replace_at(stamp_ns) for stamp_ns in (1, 2, 5, 6, 7, 9)]
    assert changes == [True, False, True, False, True, False] and references.in_use is at_7
    references.take([Frame(skin(100), 10)], SHAPE)
    taken = references.in_use
    assert not references.replace_at(11) and references.in_use is taken

    references.begin()
    assert references.in_use is given and references.replace_at(1)
    references.take([Frame(skin(100), 2)], SHAPE)  # ends the use of recorded ones, not of those at given moments
    assert not references.replace_at(5) and references.replace_at(7) and references.in_use is at_7

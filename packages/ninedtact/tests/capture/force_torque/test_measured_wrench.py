"""Around every device: what is refused, the tare, the mount, and a device's clock beside ours."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from played import MS, Played, noisy
from scipy.spatial.transform import Rotation

from ninedtact.capture.force_torque.driver_source import DeviceClock
from ninedtact.capture.force_torque.sample_checks import (
    CheckedWrenchSource,
    SampleCheckSettings,
    SkippingWrenchSource,
)
from ninedtact.capture.force_torque.tare import (
    TareRefused,
    TareSettings,
    compute_tare,
)
from ninedtact.capture.force_torque.wrench_source_from_address import (
    DeviceFrameWrenchSource,
    MountedWrenchSource,
)
from ninedtact.capture.frame_source import SourceEnded
from ninedtact.capture.wrench_source import (
    WrenchFaulty,
    WrenchJumped,
    WrenchSampleRejected,
    WrenchSaturated,
    WrenchSource,
)
from ninedtact.design import DesignImpossible, ForceTorqueMount
from ninedtact.errors import InputError
from ninedtact.quantities import Wrench

ZERO = np.zeros(6)
BIAS = np.array([0.3, -0.2, -1.0, 0.01, -0.02, 0.005])


def heard(source: WrenchSource) -> list[str]:
    """What each read gives until the end: a letter for a sample, the name of a refusal."""
    told = []
    with source:
        while True:
            try:
                source.read()
                told.append(".")
            except WrenchSampleRejected as refusal:
                assert "expected" in str(refusal) and "; " in str(refusal)
                told.append(type(refusal).__name__)
            except SourceEnded:
                return told


@pytest.mark.parametrize("axis", range(6))
@pytest.mark.parametrize("sign", [1, -1])
def test_a_load_counts_as_saturated_from_98_per_cent_of_the_range(axis: int, sign: int) -> None:
    limits = SampleCheckSettings(range_n=(10, 20, 30), range_nm=(1, 2, 3), jump_n=100, jump_nm=100)
    end = np.array([9.8, 19.6, 29.4, 0.98, 1.96, 2.94])
    near = 0.97 * end * (np.arange(6) != axis)
    name, unit = ("F_x", "F_y", "F_z", "T_x", "T_y", "T_z")[axis], "N" if axis < 3 else "N·m"
    with CheckedWrenchSource(
        Played([sign * (near + share * end * (np.arange(6) == axis)) for share in (0.999, 1.0001)]), limits
    ) as source:
        source.read()
        with pytest.raises(
            WrenchSaturated,
            match=rf"expected {name} of .* within ± {end[axis]:.3g} {unit}, got {sign * end[axis]:.3g};",
        ):
            source.read()
    assert heard(CheckedWrenchSource(Played([1000 * end, -1000 * end], 100.0))) == [
        ".",
        ".",
    ]  # unless the range is not known


@pytest.mark.parametrize("ranges", [{"range_n": (0, 1, 1)}, {"range_nm": (1, -1, 1)}, {"range_n": (1, 1, np.nan)}])
def test_a_range_that_no_sensor_has_is_refused(ranges: dict[str, tuple[float, float, float]]) -> None:
    with pytest.raises(InputError, match="above 0"):
        SampleCheckSettings(**ranges)


def test_a_frozen_reading_is_refused_until_it_moves_again() -> None:
    told = heard(CheckedWrenchSource(Played([*noisy(10), *[BIAS] * 400, *noisy(10)], 1.0)))
    assert told[:10] == told[-10:] == ["."] * 10
    assert told[10:211] == ["."] * 201 and set(told[211:410]) == {"WrenchFrozen"}
    assert heard(CheckedWrenchSource(Played([BIAS] * 5, 100.0))) == ["."] * 5  # too few to say, of a slow device


def test_a_leap_is_refused_and_a_level_that_lasts_is_believed_again() -> None:
    spike, level = noisy(1, (0, 0, -15, 0, 0, 0)), noisy(100, (0, 0, 0, 0.6, 0, 0))
    told = heard(CheckedWrenchSource(Played([*noisy(10), *spike, *noisy(10), *level])))
    assert told == [*["."] * 10, "WrenchJumped", *["."] * 10, *["WrenchJumped"] * 50, *["."] * 50]
    pressed_by_hand = np.linspace(ZERO, [0, 0, -30, 0.2, 0.2, 0], 100) + noisy(100)
    assert heard(CheckedWrenchSource(Played(pressed_by_hand))) == ["."] * 100
    assert heard(CheckedWrenchSource(Played([ZERO, [0, 0, -15, 0, 0, 0]], 100.0))) == [
        ".",
        ".",
    ]  # a slow device has no leaps


@pytest.mark.parametrize(
    ("change", "period_ms", "said"),
    [
        ([10, -10, 10, 0.5, -0.5, 0.5], 1.0, None),
        ([0, -10.01, 0, 0.5, 0, 0], 20.0, r"F_y .* by at most 10 N .*got -10"),
        ([0, -15, 0, 0, 0, 0.9], 1.0, r"T_z .* by at most 0\.5 N·m .*got \+0\.9"),
        ([-20, 0, 0, 0.9, 0, 0], 1.0, r"F_x .* by at most 10 N .*got -20"),
        ([0, -15, 0, 0, 0, 0.9], 20.1, None),
    ],
)
def test_a_jump_is_a_change_beyond_the_limit_of_an_axis_within_20_ms(
    change: list[float], period_ms: float, said: str | None
) -> None:
    with CheckedWrenchSource(Played([BIAS, BIAS + change], period_ms)) as source:
        source.read()
        if said is None:
            source.read()
        else:
            with pytest.raises(WrenchJumped, match=f"expected {said}"):
                source.read()


def test_who_only_looks_skips_what_cannot_be_trusted_and_is_told_once() -> None:
    told: list[WrenchSampleRejected] = []
    flaws = [WrenchFaulty("expected x, got y; z")] * 3
    with SkippingWrenchSource(Played([ZERO, *flaws, ZERO, *flaws, ZERO]), told.append) as source:
        assert len([source.read() for _ in range(3)]) == 3
        assert len(told) == 2


def wrenches_of(six: np.ndarray) -> list[Wrench]:
    return [Wrench(one[:3], one[3:]) for one in six]


def test_a_tare_is_the_bias_with_its_noise() -> None:
    tare = compute_tare(wrenches_of(noisy(1000, BIAS)), TareSettings())
    assert tare.mean == pytest.approx(BIAS, abs=0.004) and tare.deviation[:3] == pytest.approx(0.02, rel=0.15)
    with pytest.raises(TareRefused, match="expected 8 samples"):
        compute_tare(wrenches_of(noisy(7)), TareSettings())


@pytest.mark.parametrize(
    "moving",
    [
        np.linspace(ZERO, [0.2, 0, 0, 0, 0, 0], 1100),
        np.r_[np.zeros((500, 6)), np.tile([0, 0, -1.0, 0, 0, 0], (300, 1)), np.zeros((300, 6))],
        np.outer(np.sin(np.arange(1100) / 200), [0, 0, 0, 0.01, 0, 0]),
    ],
    ids=["drifts", "was touched", "swings"],
)
def test_a_tare_of_a_load_that_moves_is_refused(moving: np.ndarray) -> None:
    with pytest.raises(TareRefused, match=r"expected a load at rest .* take the hand away"):
        compute_tare(wrenches_of(moving + noisy(1100)), TareSettings())


def test_the_mount_turns_what_the_device_feels_into_what_the_object_does_to_the_skin() -> None:
    push = [0, 0, -5.0, 0, 0, 0]  # at the skin's centre, straight down
    with MountedWrenchSource(Played([push])) as source:
        wrench = source.read()
    assert wrench.force_n.tolist() == [0, 0, -5] and wrench.about_mm.tolist() == [0, 0, -35]
    sideways = [1.0, 0, 0, 0, 0.035, 0]  # 1 N along x at the skin: felt 35 mm below with its lever
    with MountedWrenchSource(Played([sideways])) as source:
        assert source.read().about(np.zeros(3)).torque_nm == pytest.approx(0, abs=1e-12)
    # Hung upside down (turned about x), a quarter about z, the device telling the reaction.
    mount = ForceTorqueMount((1.0, 2.0, -40.0), (180.0, 0.0, 90.0), -1)
    with MountedWrenchSource(Played([[1.0, 2.0, 3.0, 0.1, 0.2, 0.3]]), mount) as source:
        wrench = source.read()
    assert wrench.force_n == pytest.approx([-2, -1, 3]) and wrench.torque_nm == pytest.approx([-0.2, -0.1, 0.3])
    assert wrench.about_mm.tolist() == [1, 2, -40]
    with pytest.raises(DesignImpossible, match="rotation_deg"):
        ForceTorqueMount(rotation_deg=(0, 0, float("nan")))


angles = st.tuples(*[st.floats(-180, 180)] * 3)
points = st.tuples(*[st.floats(-90, 90)] * 3)


@settings(max_examples=50, deadline=None)
@given(st.tuples(*[st.floats(-9, 9)] * 6), angles, points, points, st.sampled_from([1, -1]))
def test_a_wrench_on_the_skin_is_found_from_what_any_mounted_device_feels_and_the_other_way_round(
    six, rotation_deg, origin_mm, about_mm, sign
) -> None:
    """The device feels the force along its own axes and the torque about a point of its own frame."""
    force, torque, turn = np.array(six[:3]), np.array(six[3:]), Rotation.from_euler("xyz", rotation_deg, degrees=True)

    def felt_about(point_mm: np.ndarray) -> Wrench:
        moved = torque - np.cross((origin_mm + turn.apply(point_mm)) / 1e3, force)
        return Wrench(sign * turn.inv().apply(force), sign * turn.inv().apply(moved), about_mm=point_mm)

    mount = ForceTorqueMount(origin_mm, rotation_deg, sign)
    with MountedWrenchSource(Played([felt_about(np.array(about_mm))]), mount) as mounted:
        found = mounted.read()
    assert found.about(np.zeros(3)).six == pytest.approx(np.array(six), abs=1e-9)
    assert found.about_mm == pytest.approx(origin_mm + turn.apply(about_mm), abs=1e-9)
    with DeviceFrameWrenchSource(Played([found]), mount) as device:
        felt = device.read()
    assert felt.six == pytest.approx(felt_about(np.zeros(3)).six, abs=1e-9) and felt.about_mm.tolist() == [0, 0, 0]


@settings(max_examples=20, deadline=None)
@given(st.floats(0.995, 1.005), st.integers(0, 2**32 - 1), st.integers(1, 16), st.integers(0, 10**6))
def test_stamps_follow_the_device_through_bundles_wraps_and_a_clock_that_is_off(rate, begin_us, bundle, seed) -> None:
    true_ns = 10**9 + np.arange(1000) * MS
    wakes_late_ns = np.random.default_rng(seed).exponential(0.2 * MS, 1000).astype(int)
    last_of_bundle = np.minimum(np.arange(1000) // bundle * bundle + bundle - 1, 999)
    arrived = np.maximum.accumulate((true_ns + wakes_late_ns)[last_of_bundle])
    clock = DeviceClock()
    device_us = [(begin_us + int(at / 1000 * rate)) % 2**32 for at in true_ns]
    stamps = np.array([clock.stamp_ns(us, int(at)) for us, at in zip(device_us, arrived, strict=True)])
    assert (np.diff(stamps) > 0).all() and (stamps <= arrived + 1000).all()
    late_ms = (stamps - true_ns)[200:] / MS
    assert late_ms.min() >= -0.01 and late_ms.max() < 2  # by their arrivals alone: up to 16
    restarted = clock.stamp_ns((device_us[-1] - 10**6) % 2**32, int(arrived[-1]) + 5 * MS)
    assert restarted == arrived[-1] + 5 * MS

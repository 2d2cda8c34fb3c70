"""A twin on the page: its skin moves, and what presses it stands beside, from the same moment."""

import re
import time
from itertools import count

import numpy as np
from small_sensor import wait_until

from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.capture.wrench_source import WrenchSensorLost, WrenchSource
from ninedtact.force.estimator_and_scale import unknown_wrench_estimate
from ninedtact.live.wrench_history import WrenchHistory, WrenchPoller, WrenchWithUncertainty
from ninedtact.quantities import EstimateWarning, Wrench, WrenchEstimate
from ninedtact.studio.page_cards import wrench_meaning_html, wrench_table_html
from ninedtact.studio.wrench_curves import component_curve_and_error_band


def pushed(force: tuple[float, float, float], at: tuple[float, float], twist_nm: float = 0.0) -> Wrench:
    torque = np.cross([*(np.array(at) / 1e3), 0.0], force) + np.array([0, 0, twist_nm])
    return Wrench(np.array(force, float), torque)


class FallingWeight(WrenchSource):
    """Presses one newton harder with every sample, until it is unplugged."""

    name = "falling weight"

    def __init__(self) -> None:
        self.is_open, self.plugged_in, self.samples = False, True, count()

    def open(self) -> None:
        self.is_open = True

    def read(self) -> Wrench:
        time.sleep(0.02)
        if not self.is_open:
            raise SourceNotOpen(self.name)
        if not self.plugged_in:
            raise WrenchSensorLost("expected a sample of the falling weight, got none; plug it in")
        force = np.array([0.0, 0.0, -float(next(self.samples))])
        return Wrench(force, np.zeros(3), np.array([0.0, 0.0, -35.0]), time.monotonic_ns())

    def close(self) -> None:
        self.is_open = False


def test_a_wrench_loop_gives_the_wrench_of_the_asked_moment() -> None:
    weight = FallingWeight()
    with WrenchPoller(weight, "measured", "by a weight") as poller:
        loop = poller.history
        wait_until(lambda: loop.snapshot(None, 0).history.shape[1] > 8)
        now_ns = time.monotonic_ns()
        moment = loop.snapshot(None, now_ns)
        at_s, fell = moment.history[0], moment.history[3]
        assert (at_s < 0).all() and (np.diff(at_s) > 0).all() and (np.diff(fell) < 0).all()
        sample = loop.snapshot(now_ns + round(at_s[3] * 1e9) + 1_000_000, now_ns).sample
        assert sample is not None
        earlier = sample.wrench
        assert earlier.force_n[2] == fell[3] and (earlier.about_mm == 0).all()
        weight.plugged_in = False
        wait_until(lambda: loop.snapshot(None, 0).trouble is not None)
        assert "plug it in" in wrench_table_html([loop.snapshot(None, 0)], is_past=False)
    assert not weight.is_open


def test_true_and_estimated_wrench_stand_side_by_side() -> None:
    wrench, std = pushed((0.5, 0.0, -3.0), (0.0, 0.0)), np.array([0.1, 0.2, 0.4, 1e-3, 2e-3, 3e-4])
    true = WrenchHistory("true", "of the simulation")
    true.add(WrenchWithUncertainty(pushed((0.4, 0.0, -3.2), (0.0, 0.0)), np.full(6, np.nan)))
    estimated = WrenchHistory("estimated", "by physics", ("gel not calibrated for force",), states_errors=True)
    estimated.add_estimate(WrenchEstimate(wrench, np.diag(std**2), True, (EstimateWarning.OUT_OF_RANGE,)))
    moments = [history.snapshot(None, 0) for history in (true, estimated)]
    said = wrench_table_html(moments, is_past=False) + wrench_meaning_html(moments)
    rows = {plain[:2]: plain for row in said.split("<tr>")[2:] if (plain := re.sub("<[^>]*>", "", row))}
    assert rows["Fx"].startswith("Fx N+0.40+0.50 ± 0.10") and rows["Tz"].startswith("Tz N·mm+0.00+0.00 ± 0.30")
    assert rows["Fz"].startswith("Fz N\N{MINUS SIGN}3.20\N{MINUS SIGN}3.00 ± 0.40")
    assert all(text in said for text in ("out of range", "gel not calibrated", "true: of the simulation"))


def test_an_unknown_wrench_is_no_number() -> None:
    estimated = WrenchHistory("estimated", "by physics", states_errors=True)
    estimated.add_estimate(unknown_wrench_estimate(0, (EstimateWarning.IMAGE_DARK,)))
    said = wrench_table_html([estimated.snapshot(None, 0)], is_past=False)
    assert said.count("unknown") == 6 and "0.00" not in said and "image dark" in said


def test_texts_on_the_page_are_escaped() -> None:
    true = WrenchHistory("true", 'of <b>"this"</b>', ("<i>notice</i>",))
    true.trouble = ValueError("<u>trouble</u>")
    true.add(WrenchWithUncertainty(Wrench(np.zeros(3), np.zeros(3)), np.full(6, np.nan), ("<s>warning</s>",)))
    moments = [true.snapshot(None, 0)]
    said = wrench_table_html(moments, is_past=False) + wrench_meaning_html(moments)
    assert not re.search("<[bius]>", said) and all(word in said for word in ("notice", "trouble", "warning"))


def test_curves_have_the_band_of_their_error_where_samples_are() -> None:
    history, now_ns = WrenchHistory("estimated", "by physics", states_errors=True), 10**10
    for second in range(1, 10):
        wrench = Wrench(np.array([0.0, 0.0, -second]), np.zeros(3), stamp_ns=second * 10**9)
        history.add_estimate(WrenchEstimate(wrench, np.eye(6) * 0.25, True))
    at_s = np.array([-12.0, -9.0, -5.5, -1.0, -0.5])
    value, upper, lower = component_curve_and_error_band(history.snapshot(None, now_ns), at_s, 2, 1.0)
    np.testing.assert_allclose(value, [np.nan, -1, -4.5, -9, np.nan])
    np.testing.assert_allclose([upper, lower], [[-1, -0.5, -4, -8.5, -9], [-1, -1.5, -5, -9.5, -9]])

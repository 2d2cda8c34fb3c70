"""Each client gets whole moments as fast as it takes them; one that is too slow gets fewer points, and it alone."""

from pathlib import Path

from page_client import served_small_page
from small_sensor import SHAPE, wait_until

from ninedtact.studio.viewer import MAX_COARSER, MAX_LEFT_OUT, PACE_OVER_S, RETRY_S, ClientSurfaceDensity


def test_a_client_that_is_too_slow_gets_fewer_points_and_it_alone(tmp_path: Path) -> None:
    with served_small_page(tmp_path) as served, served.viewer() as (fast, _), served.viewer() as (slow, viewer):
        rows, cols, _ = SHAPE.rectify.source_px.shape
        viewer.pace.coarser, viewer.pace.left_out = MAX_COARSER, 0.9
        wait_until(lambda: served.refresh() and slow.shows("keep up") and bool(fast.surfaces) and bool(slow.surfaces))
    assert set(fast.surfaces) == {rows * cols} and not fast.shows("keep up")
    assert set(slow.surfaces) == {-(-rows // MAX_COARSER) * -(-cols // MAX_COARSER)}


def test_density_falls_while_moments_are_left_out_and_rises_again_more_and_more_carefully() -> None:
    pace, now_s = ClientSurfaceDensity(), 0.0

    def seconds_until(coarser: int, left_out: float) -> float:
        nonlocal now_s
        began_s = now_s
        while pace.coarser != coarser:
            assert now_s < began_s + 1000
            now_s += 0.05
            pace.count_moment(round(now_s / 0.05) % 10 < 10 * left_out, now_s)
        return now_s - began_s

    assert seconds_until(2, left_out=0.8) <= PACE_OVER_S + 0.1
    assert "1 of 4 points" in pace.sentence and "80% of the moments" in pace.sentence
    first = seconds_until(1, left_out=0.0)
    assert first > RETRY_S and pace.sentence == ""
    seconds_until(MAX_COARSER, left_out=0.8)
    assert seconds_until(1, left_out=0.0) > 2 * first
    for _ in range(1000):
        now_s += 0.05
        pace.count_moment(round(now_s / 0.05) % 10 < 10 * (MAX_LEFT_OUT - 0.1), now_s)
    assert pace.coarser == 1

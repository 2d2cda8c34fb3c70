"""How many images of a video are missing follows from the times of the others and from what its header announces."""

import numpy as np
import pytest

from ninedtact.capture.video_file import count_missing_images


def missing(positions_ms: object, rate_hz: float = 25.0, announced: float = 0.0) -> int:
    return count_missing_images(np.asarray(positions_ms, float).tolist(), rate_hz, announced)


EVEN = np.arange(20) * 40.0


def test_a_whole_video_misses_nothing() -> None:
    assert missing(EVEN) == missing(EVEN, announced=20) == 0
    assert missing(EVEN, rate_hz=0, announced=20) == 0  # a header without a rate announces nothing


@pytest.mark.parametrize("gone", [[7], [7, 8], [3, 11, 12]])
def test_gaps_of_an_even_video_are_counted(gone: list[int]) -> None:
    many = np.arange(60) * 40.0
    assert missing(np.delete(many, gone)) == len(gone)


def test_a_camera_that_slows_down_leaves_no_gaps() -> None:
    uneven = np.cumsum(np.r_[[40.0] * 8, [70.0] * 3, [100.0] * 3, [40.0] * 5])
    assert missing(uneven) == 0


def test_a_third_of_a_step_too_late_is_no_gap_and_a_whole_one_is() -> None:
    late = np.r_[EVEN, EVEN[-1] + 40 + 19, EVEN[-1] + 40 + 19 + 40 * np.arange(1, 30)]
    assert missing(late) == 0
    assert missing(np.r_[EVEN, EVEN[-1] + 40 + 21 + 40 * np.arange(30)]) == 1


@pytest.mark.parametrize(("announced", "expected"), [(20, 0), (21, 1), (25, 5), (19, 0)])
def test_the_end_of_an_even_video_is_where_its_header_says(announced: int, expected: int) -> None:
    assert missing(EVEN, announced=announced) == expected


def test_half_a_second_may_lack_at_the_end_of_an_uneven_video() -> None:
    uneven = np.cumsum([40.0] * 10 + [80.0, 40.0] * 5)
    reached = uneven[-1] + 40
    assert missing(uneven, announced=(reached + 490) * 25 / 1000) == 0
    assert missing(uneven, announced=(reached + 520) * 25 / 1000) == 13
    slow = 25 * uneven  # an image a second: an image and a half may lack there
    assert missing(slow, rate_hz=1.0, announced=25 * reached / 1000 + 1.49) == 0
    assert missing(slow, rate_hz=1.0, announced=25 * reached / 1000 + 1.51) == 2


def test_a_video_is_even_where_nine_in_ten_steps_are_within_a_quarter_of_the_usual() -> None:
    """Twenty steps of which one is of two periods and others are somewhat long."""
    for long_steps, within, counted in ((1, 0.24, 1), (1, 0.26, 0), (0, 0.26, 1)):
        steps = [40.0] * (19 - long_steps) + [40 * (1 + within)] * long_steps + [80.0]
        assert missing(np.cumsum([0.0, *steps])) == counted


def test_a_video_without_images_misses_all_that_it_announces() -> None:
    assert missing([], announced=12) == 12 and missing([], announced=1) == 1
    assert missing([], announced=0) == missing([], rate_hz=0, announced=12) == 0
    assert missing([0.0], announced=5) == missing([0.0], rate_hz=0.5, announced=5) == 4

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

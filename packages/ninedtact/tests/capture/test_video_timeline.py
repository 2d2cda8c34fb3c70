"""How many images of a video are missing follows from the times of the others and from what its header announces; and whether the
blocks of an image fit together.
"""

import cv2
import numpy as np
import pytest

from ninedtact.capture.video_decoding import MissingImageCounter, _has_odd_blocks, _inspect_packet


def missing(positions_ms: object, rate_hz: float = 25.0, announced: float = 0.0) -> int:
    timeline = MissingImageCounter(rate_hz, announced)
    for position in np.asarray(positions_ms, float):
        timeline.add(float(position))
    return timeline.missing_count()


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


def with_block(row: int, col: int, levels: int, rows: int = 48, cols: int = 64) -> np.ndarray:
    """A flat image of which one block of 8 x 8 pixels has another brightness."""
    grey = np.full((rows, cols), 90, np.uint8)
    grey[8 * row : 8 * row + 8, 8 * col : 8 * col + 8] += np.int8(levels).view(np.uint8)
    return grey


@pytest.mark.parametrize(("row", "col"), [(0, 0), (2, 3), (4, 7)])
def test_a_block_is_odd_beyond_four_levels_unless_many_are_or_the_scene_is(row: int, col: int) -> None:
    for sign in (1, -1):
        assert not _has_odd_blocks(with_block(row, col, 4 * sign)) and _has_odd_blocks(with_block(row, col, 5 * sign))
    scene = with_block(row, col, 40)
    scene[8 * row + 12 : 8 * row + 16] += 25  # a line of the scene, half a block below
    assert not _has_odd_blocks(scene)
    for levels, is_odd in ((9, False), (10, True)):
        many = with_block(row, col, levels)
        others = 8 * ((col + 4) % 8)
        many[:, others : others + 8] += (np.arange(48) // 8 % 2).astype(np.uint8)[:, None]  # a tenth differ by a level
        assert _has_odd_blocks(many) is is_odd


def test_blocks_are_compared_where_six_rows_follow_a_border_and_a_block_has_its_width() -> None:
    wide, high = with_block(0, 0, 100, 15, 164), with_block(0, 0, 100, 164, 8)
    assert _has_odd_blocks(wide) and not _has_odd_blocks(wide[:14])
    assert _has_odd_blocks(high) and not _has_odd_blocks(high[:, :7])
    assert not _has_odd_blocks(with_block(0, 20, 100, 15, 164))  # half a block has no mean to compare


def test_an_image_is_inspected_along_both_directions_and_one_without_loss_is_not() -> None:
    stripe = np.full((48, 320), 90, np.uint8)
    stripe[:, 80:88] += 60
    for grey, is_whole in ((stripe, False), (stripe.T, False), (np.full_like(stripe, 90), True)):
        image = np.repeat(grey[..., None], 3, 2)
        assert _inspect_packet(b"some other codec", image, is_lossless=False) == ((0, 0), True, is_whole)
        assert _inspect_packet(b"some other codec", image, is_lossless=True) == ((0, 0), True, True)
        jpeg = cv2.imencode(".jpg", np.full((48, 320, 3), 90, np.uint8))[1].tobytes()
        assert _inspect_packet(jpeg, np.full((48, 320, 3), 90, np.uint8), is_lossless=False) == ((48, 320), True, True)
        assert _inspect_packet(jpeg[:-2], np.full((48, 320, 3), 90, np.uint8), is_lossless=False)[1] is False
        without_header = _inspect_packet(b"\xff\xd8\xff\xd9", np.repeat(stripe[..., None], 3, 2), is_lossless=False)
        assert without_header == ((0, 0), True, True)

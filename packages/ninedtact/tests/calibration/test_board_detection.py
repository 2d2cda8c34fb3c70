"""Closed forms of the detection of the board: spots, steps, candidates, and what is said where there is no board."""

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from ninedtact.calibration.board import detection
from ninedtact.calibration.board.detection import (
    BoardCandidate,
    BoardNotFound,
    DarkSpots,
    PinLattice,
    _expected_step,
    _find_spot_near,
    _images_look_swapped,
    _is_unambiguous,
    _lattice_seeds,
    _spans_square_lattice,
    detect_dark_spots,
    find_board_candidate,
    is_plausible_board,
    lattice_to_skin_mm,
    make_board_not_found_error,
    predict_missing_pins,
)
from ninedtact.calibration.board.lens_fit import LensFit, fit_lens_with_terms
from ninedtact.design import PinBoard
from ninedtact.shape.lens_and_rectification import LensModel

SMALL = PinBoard(4, 5, 2.5)
NODES = np.array([(column, row) for row in range(4) for column in range(5)])
POINTS_MM = lattice_to_skin_mm(NODES, SMALL, 0)
STRAIGHT = LensModel((0.0625, 0.0, 0.0, 0.0, 0.0625, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (480, 640))
"""20 pixels per mm, without distortion."""
FIT = fit_lens_with_terms(POINTS_MM, STRAIGHT.to_px(POINTS_MM), (480, 640), 1)


def with_errors(fit: LensFit, errors_mm: float | list[float]) -> LensFit:
    """The same fit, of which these are the lengths of the leave-one-out errors."""
    fit = replace(fit)
    fit.__dict__["leave_one_out_errors_mm"] = np.column_stack([np.broadcast_to(errors_mm, 20), np.zeros(20)])
    return fit


def candidate_with(errors_mm: float | list[float], pins: int = 20, strength: float = 1.0) -> BoardCandidate:
    """A candidate of this many pins with these lengths of the leave-one-out errors."""
    lattice = PinLattice(NODES[:pins], FIT.points_px[:pins], np.full(pins, strength))
    return BoardCandidate(lattice, 0, with_errors(FIT, errors_mm))


def test_noise_has_the_spots_that_it_had() -> None:
    """The size of the spots and of their neighbourhood has a part in these figures; who changes one on purpose writes them anew."""
    noise = np.random.default_rng(0).normal(0, 3, (120, 160)).astype(np.float32)
    spots, fine = detect_dark_spots(noise, 3.0), detect_dark_spots(noise, 1.0)
    assert (len(spots.points_px), spots.points_px[:3].tolist()) == (161, [[38, 44], [127, 0], [146, 37]])
    np.testing.assert_allclose(spots.strength[[0, 1, 2, -1]], [1.58499, 1.29992, 1.28982, 0.151214], rtol=1e-4)
    assert len(fine.points_px) == 250 and (np.diff(fine.strength) <= 0).all()
    assert len(detect_dark_spots(np.zeros((60, 80), np.float32), 3.0).points_px) == 0


def test_a_lattice_starts_from_the_sixteen_spots_nearest_to_the_middle_and_their_eight_neighbours() -> None:
    grid = np.array(list(product(range(0, 90, 10), range(0, 70, 10))), float)
    seeds = {seed for seed, _, _ in _lattice_seeds(DarkSpots(grid, np.ones(63)), np.array([41.0, 32.0]))}
    nearest = np.argsort(np.hypot(*(grid - [41, 32]).T))[:16]
    assert seeds == set(nearest.tolist())
    beside = [(9.0, 0.0), (-9.1, 0), (0, -9.2), (-6.5, -6.6), (6.5, -6.6), (-9.3, 3), (-9.4, -3), (0, 9.9), (12.0, 0)]
    spots = DarkSpots(np.array([(0.0, 0.0), *beside]) + 100, np.ones(10))
    steps = [(u.tolist(), v.tolist()) for seed, u, v in _lattice_seeds(spots, np.full(2, 100.0)) if seed == 0]
    np.testing.assert_allclose(steps, [([9.0, 0.0], [0.0, 9.9])], atol=1e-9)


def test_steps_of_which_one_is_as_long_as_the_limit_span_no_lattice() -> None:
    assert not _spans_square_lattice(np.array([10.0, 0.0]), np.array([0.0, 16.0]))
    assert _spans_square_lattice(np.array([0.5, 0.0]), np.array([0.0, 0.7]))
    assert not _spans_square_lattice(np.array([0.5, 0.0]), np.array([0.5, 0.5]))


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_step_is_the_mean_of_the_parallel_ones_around_it(direction: tuple[int, int]) -> None:
    nodes = [node for node in product(range(-3, 4), repeat=2) if node not in ((-1, 1), (1, -1), (2, 0))]
    at = dict(zip(nodes, np.random.default_rng(1).normal(0, 1, (len(nodes), 2)), strict=True))
    places = [(float(x), float(y)) for x, y in at.values()]
    taken = {node: number for number, node in enumerate(nodes)}
    ends = [(1 + a, b) for a in (-1, 0, 1) for b in (-1, 0, 1)]
    steps = [(end, (end[0] - direction[0], end[1] - direction[1])) for end in ends]
    expected = np.mean([at[end] - at[start] for end, start in steps if end in at and start in at], axis=0)
    found = _expected_step(places, taken, (1, 0), direction, (9.0, 9.0))
    np.testing.assert_allclose(found, expected)
    assert _expected_step(places, {(0, 0): 3}, (0, 0), direction, (9.0, 8.0)) == (9.0, 8.0)


@pytest.mark.parametrize(("distance", "found"), [(2.9, 1), (3.0, None), (3.1, None)])
def test_the_next_spot_lies_within_a_third_of_a_step_and_is_free(distance: float, found: int | None) -> None:
    spots = DarkSpots(np.array([(0.0, 0.0), (10 + distance, 0), (10, 5)]), np.ones(3))
    expected, step = (10.0, 0.0), (6.0, 8.0)
    assert _find_spot_near(spots, {(0, 0): 0}, expected, step) == found
    assert _find_spot_near(spots, {(0, 0): 0, (0, 1): 1}, expected, step) is None


@pytest.mark.parametrize(
    ("error_mm", "pins", "plausible", "unambiguous"),
    [
        (0.199, 20, True, True),
        (0.2, 20, True, False),
        (0.199, 19, True, False),
        (0.249, 20, True, False),
        (0.25, 20, False, False),
        (0.1, 10, True, False),
        (0.1, 9, False, False),
    ],
)
def test_a_board_is_plausible_with_half_of_its_pins_and_certain_with_all(
    error_mm: float, pins: int, plausible: bool, unambiguous: bool
) -> None:
    candidate = candidate_with(error_mm, pins)
    assert (is_plausible_board(candidate, SMALL), _is_unambiguous(candidate, SMALL)) == (plausible, unambiguous)


def test_spots_are_consistent_up_to_a_tenth_of_the_pitch_whichever_come_first() -> None:
    """A cut lattice may begin with any of its nodes, so that the first two need not be neighbours."""
    errors = [0.0, 0.3, 0.249, 0.25, 0.251, *[0.0] * 15]
    candidate = candidate_with(errors)
    other = replace(FIT, points_mm=FIT.points_mm[::-1][[0, 9, *range(1, 9), *range(10, 20)]])
    for each in (candidate, replace(candidate, fit=with_errors(other, errors))):
        seen = each.consistent_spots_px(SMALL)
        np.testing.assert_array_equal(seen, np.delete(FIT.points_px, [1, 3, 4], axis=0))


def test_more_pins_come_first_then_the_better_lens_and_a_certain_board_ends_the_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    few, bad, good, certain = (candidate_with(*how) for how in ((0.01, 12), (0.23, 20), (0.22, 20), (0.19, 20)))
    better = candidate_with(0.1)

    def best_of(*candidates: BoardCandidate) -> BoardCandidate | None:
        monkeypatch.setattr(detection, "_generate_board_candidates", lambda *_: iter(candidates))
        return find_board_candidate(np.zeros((4, 4), np.float32), SMALL, 0)

    assert best_of() is None
    assert best_of(few, bad, good) is good and best_of(good, bad, few) is good and best_of(bad, few) is bad
    assert best_of(certain, better) is certain and best_of(good, certain, better) is certain


def test_spots_of_five_sizes_are_sought_about_the_middle(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, middles = [], []

    def detect(image: np.ndarray, size_px: float) -> DarkSpots:
        sizes.append(size_px)
        return DarkSpots(np.empty((0, 2)), np.empty(0))

    def find(spots: DarkSpots, middle_px: np.ndarray) -> list[PinLattice]:
        middles.append(middle_px.tolist())
        return []

    monkeypatch.setattr(detection, "detect_dark_spots", detect)
    monkeypatch.setattr(detection, "find_pin_lattices", find)
    assert find_board_candidate(np.zeros((480, 640), np.float32), SMALL, 0) is None
    assert sizes == pytest.approx([6, 8, 4, 11, 3], rel=0.0035) and middles == [[320, 240]] * 5


@pytest.mark.parametrize(("pins", "found"), [(9, True), (8, False)])
def test_a_lens_needs_nine_pins(pins: int, found: bool) -> None:
    y, x = np.mgrid[:100, :100]
    places = list(product((30, 50, 70), repeat=2))[:pins]
    image = -sum(5 * np.exp(-((x - a) ** 2 + (y - b) ** 2) / 2 / 3.0**2) for a, b in places).astype(np.float32)
    candidate = find_board_candidate(image, PinBoard(3, 3), "auto")
    assert (candidate is not None) == found
    assert candidate is None or (candidate.mounting, len(candidate.fit.lens.radial)) == (0, 1)


def test_each_mounting_is_its_own_and_auto_tries_the_first_two() -> None:
    expected = {"auto": (0, 90), 0: (0,), 90: (90,), 180: (180,), 270: (270,)}
    assert expected == detection.CAMERA_ROTATIONS


DYADIC = LensModel((0.125, 0.0, 1 / 512, 0.0, 0.125, 0.0, 0.0, 0.0), (0.0, 0.0), (0.0,), (0.0, 0.0), (385, 512))
"""The pins of a board with a pitch of 2 mm at whole pixels: columns 0, 64, …, 512, rows 0, 64, …, 384."""


def test_missing_pins_are_those_within_the_image_farther_than_half_a_pitch_from_any_spot() -> None:
    board = PinBoard(7, 9, 2.0)
    nodes = np.array([(column, row) for row in range(7) for column in range(9)])
    points_px = DYADIC.to_px(lattice_to_skin_mm(nodes, board, 0))
    np.testing.assert_array_equal(points_px, 64.0 * nodes)
    inner = ((nodes >= (2, 2)) & (nodes <= (6, 4))).all(axis=1)
    fit = LensFit(DYADIC, lattice_to_skin_mm(nodes, board, 0), points_px, np.zeros((126, 13)))
    candidate = BoardCandidate(PinLattice(nodes[inner], points_px[inner], np.ones(inner.sum())), 0, fit)
    seen_px = np.vstack(
        [points_px[inner], [64 + 32.0, 64], [64, 192 + 32.5]]
    )  # beside (1, 1) and (2, 1), beyond (1, 3)
    missing = predict_missing_pins(candidate, board, seen_px, (384, 512))
    left = ~inner & (nodes < (8, 6)).all(axis=1) & ~((nodes == (1, 1)) | (nodes == (2, 1))).all(axis=1)
    left &= ~(nodes == (1, 4)).all(axis=1)  # the spot beyond (1, 3) is near to it
    np.testing.assert_array_equal(missing, points_px[left])


def test_an_image_without_contact_has_less_range_than_four_times_its_noise() -> None:
    """Smoothing leaves 100 / (100 + 2²) of a spot whose variance is 100, and the noise counts as 0.1 at least."""
    y, x = np.mgrid[:120, :120]
    spot = -np.exp(-((x - 60) ** 2 + (y - 60) ** 2) / 2 / 100)
    for range_levels, touched in ((0.39, False), (0.41, True)):
        change = (range_levels * 104 / 100 * spot).astype(np.float32)
        error = make_board_not_found_error(change, SMALL, np.ones((3, 2)))
        assert ("nothing touched" in str(error), error.found_pins) == ((False, 3) if touched else (True, 0))
        assert error.missing_px.shape == (0, 2) and error.expected_pins == 20


def test_other_pins_are_predicted_for_a_plausible_board_of_which_something_was_seen() -> None:
    change = np.zeros((330, 430), np.float32)
    change[200:240, 300:340] = -9
    seen, plausible, unlike = FIT.points_px[:12], candidate_with(0.1, 12), candidate_with(0.3, 12)
    assert len(make_board_not_found_error(change, SMALL, seen, plausible).missing_px) == 8
    for spots, candidate in ((seen, unlike), (seen[:0], plausible), (seen, None)):
        error = make_board_not_found_error(change, SMALL, spots, candidate)
        assert error.missing_px.shape == (0, 2) and error.found_pins == len(spots)
        assert "press harder" in str(error)


@pytest.mark.parametrize(
    ("inverted", "candidate", "swapped"),
    [
        (candidate_with(0.1, 20, 2.0), candidate_with(0.1, 20, 1.9), True),
        (candidate_with(0.1, 20, 2.0), candidate_with(0.1, 20, 2.0), False),
        (candidate_with(0.1, 20, 2.0), candidate_with(0.1, 20, 2.1), False),
        (candidate_with(0.1, 20, 2.0), None, True),
        (candidate_with(0.1, 19, 2.0), None, False),
        (None, None, False),
        (None, candidate_with(0.1), False),
    ],
)
def test_a_whole_board_that_is_brighter_than_any_darker_one_is_of_swapped_images(
    inverted: BoardCandidate | None,
    candidate: BoardCandidate | None,
    swapped: bool,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    change = np.arange(48, dtype=np.float32).reshape(6, 8)

    def find(image: np.ndarray, board: PinBoard, mounting: object) -> BoardCandidate | None:
        np.testing.assert_array_equal(image, -change)
        assert (board, mounting) == (SMALL, "auto")
        return inverted

    monkeypatch.setattr(detection, "find_board_candidate", find)
    assert _images_look_swapped(change, SMALL, candidate) == swapped


def test_a_drawing_is_named_in_the_same_error() -> None:
    given = ("words", 3, 63, np.ones((3, 2)), np.zeros((4, 5), np.float32), np.zeros((2, 2)))
    error = BoardNotFound(*given).with_drawing(Path("drawn.png"))
    assert str(error) == "words; what was detected is drawn in drawn.png"
    assert (error.found_pins, error.expected_pins, error.detected_px.shape, error.missing_px.shape) == (
        3,
        63,
        (3, 2),
        (2, 2),
    )

"""The board's own check: sound boards pass it, every damage is found."""

from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import LineString

from ninedtact.design import DesignImpossible
from ninedtact_hardware.led_board.board_outline_and_holes import BoardOutline, LedBoardImpossible
from ninedtact_hardware.led_board.board_parameters import (
    BoardDesignRules,
    LedBoardDesign,
    LedPositions,
    TrackAndViaDimensions,
)
from ninedtact_hardware.led_board.complete_layout import BoardLayout, lay_out_board
from ninedtact_hardware.led_board.design_rule_check import (
    find_open_nets,
    find_violations,
    list_copper_pieces,
    require_no_violations,
)
from ninedtact_hardware.led_board.routing import Routes, Track


def rules_broken(layout: BoardLayout) -> set[str]:
    return {problem.rule for problem in find_violations(layout)}


def test_the_improved_board_breaks_no_rule(improved: BoardLayout) -> None:
    assert find_violations(improved) == ()


def test_the_improved_board_holds_together_without_its_pour() -> None:
    assert find_violations(lay_out_board(LedBoardDesign(copper=TrackAndViaDimensions(pour=False)))) == ()


def test_the_originals_faults_are_named(original: BoardLayout) -> None:
    found = {str(problem).rsplit(" ", 3)[0].removesuffix(":") for problem in find_violations(original)}
    assert rules_broken(original) == {"clearance", "copper to edge", "copper to hole"}
    assert any("LED7.1" in line for line in found) and any("LED1.2" in line for line in found)
    require_no_violations(original)


def spared(layout: BoardLayout) -> list[Track]:
    """Tracks that may be taken away one by one, and every net is still one piece."""
    copper = list_copper_pieces(layout)
    return [
        track
        for number, track in enumerate(layout.routes.tracks)
        if not find_open_nets(
            layout, tuple(piece for piece in copper if piece.name != f"track {number} of {track.net}")
        )
    ]


def test_every_track_of_the_original_is_needed(original: BoardLayout) -> None:
    """But two stubs, which lie wholly on a pad or a via of the line that they lead to."""
    assert all(LineString(track.points).length < 0.2 for track in spared(original))


def test_every_track_of_the_improved_board_is_needed_where_ground_has_not_several_ways(improved: BoardLayout) -> None:
    """LED+ goes from one via to its twin on both sides; all else that carries 5 V or a setting has one way."""
    assert [track.net for track in spared(improved) if track.net != "GND"] == ["LED+", "LED+"]


def test_a_via_less_is_found(original: BoardLayout) -> None:
    routes = original.routes
    kept = tuple(via for via in routes.vias if via.net != "LED+")
    assert "LED+" in {p.where for p in find_violations(replace(original, routes=Routes(routes.tracks, kept)))}


def test_a_short_is_found(improved: BoardLayout) -> None:
    bridge = Track("LED+", "top", 0.3, ((-8.8, 7.5), (-7.8, 7.5)))
    routes = improved.routes + Routes((bridge,))
    assert "clearance" in rules_broken(replace(improved, routes=routes))


def test_an_open_pin_is_a_net_of_its_own(improved: BoardLayout) -> None:
    places = {pad.pin: pad.at_mm for pad in improved.pads}
    bridge = Track("VCC", "bottom", 0.2, (places["USB3.1"], places["USB3.2"]))
    assert "clearance" in rules_broken(replace(improved, routes=improved.routes + Routes((bridge,))))


def test_copper_over_the_edge_is_found(improved: BoardLayout) -> None:
    stray = Track("GND", "top", 0.3, ((9.8, 9.9), (9.8, 10.4)))
    assert "copper to edge" in rules_broken(replace(improved, routes=improved.routes + Routes((stray,))))


def test_components_in_the_way_of_one_another_are_found() -> None:
    """Bodies of 2.80 on rows 2.60 apart, though their pads of 2.10 are clear; and a body of 3.50 over a pin's hole of 1.50."""
    close = LedBoardDesign(leds=LedPositions(rows_mm=(7.5, 1.3, -1.3, -7.5)))
    (left, right) = find_violations(lay_out_board(close))
    assert (left.rule, left.where, left.found_mm) == ("overlap of", "LED4 and LED6", pytest.approx(-0.2))
    assert right.where == "LED5 and LED7"
    under = replace(
        LedBoardDesign(), outline=BoardOutline(locating_inset_mm=(1.5, 3.0)), leds=LedPositions((-11.0, 0.0, 11.0))
    )
    assert "LED3 and a locating hole" in {each.where for each in find_violations(lay_out_board(under))}


def test_a_part_over_a_boss_is_found() -> None:
    low = LedBoardDesign(outline=BoardOutline(boss_inset_mm=(9.0, 2.75)))
    assert "height over a boss" in rules_broken(lay_out_board(low))


@settings(deadline=None, max_examples=60)
@given(
    width=st.floats(20, 70),
    height=st.floats(16, 56),
    columns=st.integers(2, 7),
    rows=st.integers(2, 6),
)
def test_any_size_is_sound_or_refused(width: float, height: float, columns: int, rows: int) -> None:
    try:
        layout = lay_out_board(LedBoardDesign.for_size(width, height, columns, rows))
        require_no_violations(layout)
    except DesignImpossible as refusal:
        assert "expected" in str(refusal) and "got" in str(refusal) and ";" in str(refusal)
        return
    assert len(layout.nets) == 4


@settings(deadline=None, max_examples=40)
@given(width=st.floats(28, 70), height=st.floats(21, 56))
def test_eight_leds_fit_every_larger_board(width: float, height: float) -> None:
    require_no_violations(lay_out_board(LedBoardDesign.for_size(width, height)))


def test_the_middle_row_of_leds_lies_at_zero() -> None:
    """Not at minus zero, which the placement list would have."""
    assert str(LedBoardDesign.for_size(64, 48).leds.rows_mm[1]) == "0.0"


@settings(deadline=None, max_examples=30)
@given(led=st.floats(0.2, 0.6), ground=st.floats(0.2, 0.6), supply=st.floats(0.34, 0.8), neck=st.floats(0.15, 0.34))
def test_narrower_tracks_are_sound(led: float, ground: float, supply: float, neck: float) -> None:
    require_no_violations(lay_out_board(LedBoardDesign(copper=TrackAndViaDimensions(led, ground, supply, neck))))


@pytest.mark.parametrize(
    "refused",
    [
        lambda: LedBoardDesign.for_size(20, 21),
        lambda: LedBoardDesign.for_size(28, 21, columns=9),
        lambda: LedBoardDesign.for_size(28, 21, columns=1),
        lambda: LedBoardDesign.for_size(28, 21, rows=0),
        lambda: BoardOutline(lens_hole_mm=11),
        lambda: BoardOutline(thickness_mm=1.6),
        lambda: BoardOutline(notch_radius_mm=0.5),
        lambda: LedBoardDesign(resistor_ohm=1000),
        lambda: LedBoardDesign(resistor_ohm=float("nan")),
        lambda: LedBoardDesign(usb_contact_mm=0.5),
        lambda: BoardDesignRules(clearance_mm=0.01),
        lambda: require_no_violations(lay_out_board(LedBoardDesign.for_size(28, 20.2))),
        lambda: require_no_violations(lay_out_board(LedBoardDesign(usb_contact_mm=1.5))),
    ],
)
def test_impossible_boards_are_refused(refused: object) -> None:
    with pytest.raises(DesignImpossible, match=r"expected .*, got .*; "):
        refused()  # type: ignore[operator]


def test_refusals_are_of_this_room() -> None:
    assert issubclass(LedBoardImpossible, DesignImpossible)

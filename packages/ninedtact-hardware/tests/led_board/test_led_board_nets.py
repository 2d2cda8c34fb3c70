"""The netlist is the published one, and the improved one differs by what was improved."""

import pytest

from ninedtact_hardware.led_board.board_parameters import LedBoardDesign
from ninedtact_hardware.led_board.complete_layout import BoardLayout
from ninedtact_hardware.led_board.components import build_netlist

LEDS = range(1, 9)
PUBLISHED = {
    "VCC": {"USB3.1", "U1.3", "U1.4", "U1.8"},
    "GND": {"USB3.5", "U1.2", "U1.9", "R1.1", *(f"LED{n}.1" for n in LEDS)},
    "LED+": {"U1.5", "U1.6", *(f"LED{n}.2" for n in LEDS)},
    "ISET": {"U1.1", "R1.2"},
}
ADDED = {"VCC": {"C1.1"}, "GND": {"C1.2", "USB3.6", "USB3.7", "USB3.8", "USB3.9"}}
PUBLISHED_PLACES = {
    "LED1": (-8.77, 7.50),
    "LED2": (0.13, 7.50),
    "LED5": (8.83, 0.0),
    "U1": (3.49, 7.90),
    "R1": (-2.13, 7.01),
    "USB3": (0.07, -7.30),
}


def named(board: LedBoardDesign) -> dict[str, set[str]]:
    return {net.name: set(net.pins) for net in build_netlist(board)}


def test_the_original_has_the_published_nets() -> None:
    assert named(LedBoardDesign.original()) == PUBLISHED


def test_the_improved_board_adds_a_capacitor_and_ties_the_shield() -> None:
    assert named(LedBoardDesign()) == {name: pins | ADDED.get(name, set()) for name, pins in PUBLISHED.items()}


@pytest.mark.parametrize("board", [LedBoardDesign(), LedBoardDesign.original()], ids=["improved", "original"])
def test_no_pin_is_in_two_nets(board: LedBoardDesign) -> None:
    pins = [pin for net in build_netlist(board) for pin in net.pins]
    assert len(pins) == len(set(pins))


def test_every_pin_of_the_netlist_is_a_pad(improved: BoardLayout, original: BoardLayout) -> None:
    for layout in (improved, original):
        pads = {pad.pin: pad.net for pad in layout.pads}
        assert {pin: net.name for net in layout.nets for pin in net.pins} == {p: n for p, n in pads.items() if n}


def test_open_pins_stay_open(improved: BoardLayout) -> None:
    assert {pad.pin for pad in improved.pads if pad.net is None} == {"U1.7", "USB3.2", "USB3.3", "USB3.4"}


def test_the_original_has_its_parts_where_they_were_published(original: BoardLayout) -> None:
    places = {part.reference: part.at_mm for part in original.parts}
    for reference, place in PUBLISHED_PLACES.items():
        assert places[reference] == pytest.approx(place, abs=0.011), reference


def test_pads_lie_where_they_were_published(original: BoardLayout) -> None:
    places = {pad.pin: pad.at_mm for pad in original.pads}
    assert places["USB3.6"] == pytest.approx((-3.23, -5.94), abs=0.01)
    assert places["USB3.9"][1] == pytest.approx(-8.688)
    assert {round(x, 3) for pin, (x, _) in places.items() if pin.startswith("USB3.") and pin[-1] in "89"} == {
        -2.755,
        2.895,
    }
    assert places["LED4.2"] == pytest.approx((-9.0 - 1.231, 0), abs=0.001)
    assert {round(pad.at_mm[0], 2) for pad in original.pads if pad.pin in ("U1.1", "U1.4")} == {0.72}


def test_improved_leds_are_centred(improved: BoardLayout) -> None:
    places = [part.at_mm for part in improved.parts if part.side == "top"]
    assert sorted(places) == sorted((x, y) for x in (-8.8, 0, 8.8) for y in (-7.5, 0, 7.5) if (x, y) != (0, 0))

"""Any design is either built as a valid assembly or refused by the name of the rule that it breaks."""

from dataclasses import fields, replace
from math import cos, pi, sin
from typing import get_args, get_type_hints

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from clearance_agreement import require_agreement
from ninedtact.design import CameraGeometry, DesignImpossible, Gel, PinBoard, SensingArea, SensorDesign
from ninedtact_hardware.buildability import (
    DesignNotBuildable,
    find_broken_rules,
    require_buildable_design,
)
from ninedtact_hardware.buildable_design import BuildableDesign
from ninedtact_hardware.clearances import list_clearances
from ninedtact_hardware.design import (
    PART_TABLES,
    HardwareDesign,
    distance_to_edge_mm,
    lens_view_radius_mm,
    original_hardware_design,
    required_camera_distance_mm,
)
from ninedtact_hardware.design_sweep import change_design
from ninedtact_hardware.part_dimensions import (
    BaseDimensions,
    CalibrationBoardDimensions,
    CameraDimensions,
    FastenerDimensions,
    GelLayerDimensions,
    LedBoardDimensions,
    LightIsolationRingDimensions,
    MouldDimensions,
    ShellDimensions,
    WindowDimensions,
)
from ninedtact_hardware.part_geometry import find_round_features
from ninedtact_hardware.part_solids import build_sensor_base


def sensor(width: float = 24, height: float = 18, gel: float = 2.5, cols: int = 9, rows: int = 7) -> SensorDesign:
    return SensorDesign(gel=Gel(gel), sensing_area=SensingArea(width, height), pin_board=PinBoard(rows, cols))


def names(design: HardwareDesign) -> set[str]:
    return {each.rule for each in find_broken_rules(design)}


BREAKING = {
    "wall_too_thin": replace(HardwareDesign(), shell=ShellDimensions(wall_mm=0.7)),
    "led_touches_shell": replace(HardwareDesign(), board=LedBoardDimensions(thick_mm=1.6)),
    "lens_does_not_see_the_corner": HardwareDesign(sensor(30, 22)),
    "mould_too_thin_for_the_screws": HardwareDesign(sensor(gel=1.2)),
    "pins_out_of_view": HardwareDesign(sensor(cols=15, rows=11)),
    "pins_too_close": HardwareDesign(SensorDesign(pin_board=PinBoard(pitch_mm=1.5))),
    "pin_too_short": HardwareDesign(SensorDesign(pin_board=PinBoard(3, 3, 5.0, 3.2))),
    "screws_do_not_hold": replace(HardwareDesign(), moulds=MouldDimensions(base_mm=5.0)),
    "gel_beyond_the_shell": replace(HardwareDesign(), gels=GelLayerDimensions(black_side_mm=2.0)),
    "tray_does_not_pass": replace(HardwareDesign(), pin_frame=CalibrationBoardDimensions(corner_radius_mm=8.0)),
    "parts_touch": replace(
        HardwareDesign(),
        ring=LightIsolationRingDimensions(above_board_mm=0.0),
        base=BaseDimensions(pocket_wide_mm=8.0),
    ),
    "bosses_collide": replace(HardwareDesign(), base=BaseDimensions(mount_inset_mm=(3.25, 3.0))),
    "mount_in_pocket": replace(HardwareDesign(), base=BaseDimensions(mount_inset_mm=(9.0, 3.0))),
    "mount_in_wall": replace(HardwareDesign(), base=BaseDimensions(mount_inset_mm=(5.75, 2.0))),
    "pocket_in_ramp": replace(HardwareDesign(), base=BaseDimensions(pocket_back_mm=9.5)),
    "ramp_too_short": replace(HardwareDesign(), base=BaseDimensions(ramp_foot_mm=1.0)),
    "clamps_in_the_shell": replace(HardwareDesign(), moulds=MouldDimensions(beyond_mm=(8.0, 8.0))),
    "ring_cuts_the_view": replace(HardwareDesign(), window=WindowDimensions(22.0), shell=ShellDimensions(floor_mm=3.0)),
    "clamps_beyond_the_plates": replace(HardwareDesign(), moulds=MouldDimensions(pairs_mm=(35.0, 8.0))),
    "post_in_wall": replace(HardwareDesign(), board=LedBoardDimensions(locating_inset_mm=(1.0, 5.0))),
    "post_in_pocket": replace(HardwareDesign(), board=LedBoardDimensions(locating_inset_mm=(10.0, 5.0))),
    "ring_has_no_mouth": replace(HardwareDesign(), ring=LightIsolationRingDimensions(land_mm=1.0)),
    "inserts_do_not_hold": replace(HardwareDesign(), fasteners=FastenerDimensions(insert_mm=(2.0, 5.09))),
    "usb_slot": replace(HardwareDesign(), shell=ShellDimensions(slot_to_mm=4.0)),
    "camera_too_far": HardwareDesign(SensorDesign(camera=CameraGeometry(distance_mm=500.0))),
    "leds_too_bright": replace(HardwareDesign(), board=LedBoardDimensions(resistor_ohm=3_700.0)),
    "window_cuts_the_view": replace(
        HardwareDesign(),
        window=WindowDimensions(9.0, 5.0),
        shell=ShellDimensions(hole_mm=8.0),
        ring=LightIsolationRingDimensions(bore_mm=10.0),
    ),
}


@pytest.mark.parametrize("rule", BREAKING)
def test_an_impossible_design_is_refused_by_its_rule(rule: str) -> None:
    assert rule in names(BREAKING[rule])
    with pytest.raises(DesignNotBuildable, match=f"rule {rule}") as refused:
        require_buildable_design(BREAKING[rule])
    assert "expected" in str(refused.value) and "got" in str(refused.value)


@pytest.mark.parametrize(
    ("design", "part"),
    [
        (replace(HardwareDesign(), base=BaseDimensions(channel_wide_mm=8.5)), "sensor_base"),
        (replace(HardwareDesign(), shell=ShellDimensions(slot_chamfer_mm=0.2)), "sensor_shell"),
    ],
)
def test_a_fillet_that_does_not_fit_is_refused_with_its_part(design: HardwareDesign, part: str) -> None:
    with pytest.raises(DesignImpossible, match=rf"expected .* the {part} .*, got: .*; change"):
        _ = BuildableDesign(design).parts


@pytest.mark.parametrize("pairs_mm", [(10.0, 25.0), (25.0, 8.0), (27.0, 22.0)])
def test_a_mould_keeps_all_its_holes(pairs_mm: tuple[float, float]) -> None:
    """Beyond the long side, through a rounded corner, and two holes at one place."""
    moulds = MouldDimensions(pairs_mm=pairs_mm)
    assert names(replace(HardwareDesign(), moulds=moulds)) == {"clamps_beyond_the_plates"}


BORES, HEADS = "the shell outside its bores", "between counterbore, side of the base"


@pytest.mark.parametrize(
    ("wall_mm", "corner_mm", "thin"), [(1.0, 2.0, {BORES, HEADS}), (1.5, 2.0, {HEADS}), (2.0, 5.0, {BORES, HEADS})]
)
def test_screws_stay_inside_thin_walls(wall_mm: float, corner_mm: float, thin: set[str]) -> None:
    """The axes of counterbores of 4.0 and bores of 2.85 lie 0.75 inside the cavity's walls."""
    small = HardwareDesign(sensor(16, 12, cols=5, rows=3))
    shell = ShellDimensions(wall_mm=wall_mm, corner_radius_mm=corner_mm)
    broken = find_broken_rules(replace(small, base=BaseDimensions(corner_radius_mm=corner_mm), shell=shell))
    assert {each.rule for each in broken} == {"wall_too_thin"}
    assert {name for name in (BORES, HEADS) if any(name in each.message for each in broken)} == thin


@pytest.mark.parametrize(("more_mm", "whole"), [(-0.01, 4), (0.01, 0)])
def test_a_counterbore_meets_the_side_where_the_distance_says(more_mm: float, whole: int) -> None:
    """At a rounded corner, too."""
    design = replace(HardwareDesign(), base=BaseDimensions(corner_radius_mm=4.0))
    plan = design.horizontal_dimensions
    wide = 2 * (distance_to_edge_mm(max(plan.shell_screws), plan.outer, 4.0) + more_mm)
    base = build_sensor_base(replace(design, base=replace(design.base, counterbore_mm=wide)))
    found = {round(2 * each.radius_mm, 3): len(each.positions) for each in find_round_features(base)}
    assert found.get(round(wide, 3), 0) == whole


@pytest.mark.parametrize("floor_mm", [2.0, 1.4])
def test_bores_do_not_open_into_the_gel_cavity(floor_mm: float) -> None:
    """Where the LED board needs more space than the gel, the wall goes on above the bores."""
    wide, deepest = replace(HardwareDesign().shell, floor_mm=floor_mm), 6.3 + floor_mm - 0.8
    for deep_mm, area, thin in ((deepest, (24, 18), False), (deepest + 0.1, (24, 18), True), (8.0, (10, 10), False)):
        shell = replace(wide, bore_deep_mm=min(deep_mm, 8.0))
        broken = find_broken_rules(replace(HardwareDesign(sensor(*area, cols=4, rows=3)), shell=shell))
        assert any("the shell above its bores" in each.message for each in broken) == thin


@pytest.mark.parametrize(
    ("overlap_mm", "wall_mm", "corner_mm", "rim_mm", "whole"),
    [(0.9, 2.0, 2.0, 1.0, True), (1.0, 2.0, 2.0, 1.0, False), (0.5, 2.5, 5.0, 0.0, False), (0.5, 2.5, 5.0, 1.0, True)],
)
def test_the_second_mould_rests_on_the_rim(
    overlap_mm: float, wall_mm: float, corner_mm: float, rim_mm: float, whole: bool
) -> None:
    """At its sides, and at the shell's rounded corners. The solids have the rim that the rule computes."""
    area = SensingArea(overlap_mm=overlap_mm)
    design = replace(
        HardwareDesign(SensorDesign(sensing_area=area)),
        shell=ShellDimensions(wall_mm=wall_mm, corner_radius_mm=corner_mm),
        base=BaseDimensions(corner_radius_mm=corner_mm),
        gels=GelLayerDimensions(rim_radius_mm=rim_mm),
    )
    assert ("gel_beyond_the_shell" not in names(design)) == whole
    (seat_mm,) = (each.clearance_mm for each in list_clearances(design) if each.rule == "gel_beyond_the_shell")
    plan, radius = design.horizontal_dimensions, rim_mm + design.gels.black_side_mm
    x, y = (side / 2 - radius for side in plan.black)
    gel = [(x + radius * sin(turn), y + radius * cos(turn)) for turn in np.linspace(0, pi / 2, 1001)]
    assert min(distance_to_edge_mm(place, plan.outer, corner_mm) for place in gel) == pytest.approx(seat_mm, abs=1e-5)


def test_screw_heads_do_not_pass_their_holes() -> None:
    """0.4 mm of every head bears on the base, and on the base board while the gels are cured; both holes are 2.20 wide."""
    for head_mm, hole_mm, parts in ((3.0, 2.2, []), (3.0, 2.4, ["base of"]), (2.9, 2.2, ["base of", "base board of"])):
        fasteners, base = FastenerDimensions(head_mm=(head_mm, 0.85)), BaseDimensions(shell_screw_mm=hole_mm)
        broken = find_broken_rules(replace(HardwareDesign(), fasteners=fasteners, base=base))
        assert [each.rule for each in broken] == ["screws_do_not_hold"] * len(parts)
        assert all(f"hole of the {part}" in each.message for part, each in zip(parts, broken, strict=True))


def test_the_calibration_board_ends_above_the_plug() -> None:
    """The LEDs must be lit while the pins are pressed 1 mm into the skin."""
    design = HardwareDesign()
    plug_mm = design.heights.plate_top + design.shell.relief_tall_mm
    for less_mm, whole in ((0.01, True), (-0.01, False)):
        guided_mm = design.heights.rim - plug_mm - 1.0 - less_mm
        tray = replace(design, pin_frame=CalibrationBoardDimensions(guided_mm=guided_mm))
        assert (names(tray) == set()) == whole and (names(tray) == {"tray_does_not_pass"}) == (not whole)


def test_the_remedy_for_a_lens_that_sees_too_little_works() -> None:
    wide = HardwareDesign(sensor(40, 30, cols=15, rows=11))
    assert names(wide) == {"lens_does_not_see_the_corner"}
    camera = replace(wide.sensor.camera, distance_mm=required_camera_distance_mm(wide) + 0.05)
    assert find_broken_rules(HardwareDesign(replace(wide.sensor, camera=camera))) == []


def test_what_the_lens_reaches() -> None:
    """By hand: 0.35 of air, 2 of acrylic, 9.2 and 11.7 of silicone at 80° in air."""
    design = HardwareDesign()
    assert lens_view_radius_mm(design, design.heights.rim) == pytest.approx(12.7, abs=0.05)
    assert lens_view_radius_mm(design) == pytest.approx(15.2, abs=0.05)


def test_the_view_between_lens_and_window() -> None:
    """Air only: 0.35 mm at 80° from the axis, nothing at the lens itself, and half halfway."""
    design = HardwareDesign()
    low, high = design.heights.lens_front, design.heights.floor_top
    radii = [lens_view_radius_mm(design, low + share * (high - low)) for share in (0.0, 0.5, 1.0)]
    assert radii == pytest.approx([0.0, 0.99, 1.985], abs=0.005)


@pytest.mark.parametrize("variant", [HardwareDesign(), original_hardware_design()], ids=lambda it: it.variant)
def test_a_receptacle_that_cannot_pass_the_wall_is_refused(variant: HardwareDesign) -> None:
    """The mouth stands 0.09 out over the cavity, and the notches let the board give way by 0.10."""
    for beyond_mm, slot_from_mm, rules in ((0.35, 1.55, set()), (0.36, 1.55, {"parts_touch"}), (0.8, 0.0, set())):
        board, shell = (
            replace(variant.board, usb_beyond_mm=beyond_mm),
            replace(variant.shell, slot_from_mm=slot_from_mm),
        )
        broken = find_broken_rules(replace(variant, board=board, shell=shell))
        assert {each.rule for each in broken} == rules and all("wall below its slot" in each.message for each in broken)


@pytest.mark.parametrize(
    ("part", "field", "value"),
    [
        ("shell", "led_cavity_mm", 2.0),
        ("base", "plate_mm", float("nan")),
        ("base", "mount_inset_mm", (5.75, 200.0)),
    ],
)
def test_a_dimension_out_of_its_range_is_refused(part: str, field: str, value: object) -> None:
    with pytest.raises(DesignImpossible, match=f"{part}.{field}"):
        replace(HardwareDesign(), **{part: replace(getattr(HardwareDesign(), part), **{field: value})})


def test_a_camera_whose_lens_steps_down_is_refused() -> None:
    with pytest.raises(DesignImpossible, match="one above the other"):
        replace(HardwareDesign(), camera=CameraDimensions(collar_mm=(8.0, 9.0)))


swept = st.builds(
    sensor,
    width=st.floats(10, 60),
    height=st.floats(10, 45),
    gel=st.floats(1, 5),
    cols=st.integers(5, 15),
    rows=st.integers(5, 11),
)


@settings(max_examples=100, deadline=None)
@given(swept, st.booleans())
def test_rules_answer_for_every_design(design: SensorDesign, far: bool) -> None:
    hardware = change_design(HardwareDesign(design)) if far else HardwareDesign(design)
    for broken in find_broken_rules(hardware):
        assert broken.rule and broken.message.startswith("expected") and "got" in broken.message
    if far:
        assert not names(hardware) - {"pins_out_of_view", "mould_too_thin_for_the_screws"}


@given(st.floats(10, 60), st.floats(10, 45), st.just(2.5))
@example(25.4, 12.2, 2.2)
def test_a_swept_area_is_given_all_the_pins_that_it_shows(width: float, height: float, pitch_mm: float) -> None:
    """Also one that ends just at its last pins, as 11 gaps of 2.2 mm and a pin of 1.2 mm do."""
    basis = HardwareDesign(SensorDesign(pin_board=PinBoard(pitch_mm=pitch_mm)))
    wider = change_design(basis, area_mm=(width, height))
    pins = wider.sensor.pin_board
    assert "pins_out_of_view" not in names(wider)
    for more in (replace(pins, cols=pins.cols + 1), replace(pins, rows=pins.rows + 1)):
        assert "pins_out_of_view" in names(HardwareDesign(replace(wider.sensor, pin_board=more)))


def ends_of_ranges() -> list[tuple[str, str, object]]:
    """Part, dimension and the end of its range; of several numbers, one after the other at its end."""
    found: list[tuple[str, str, object]] = []
    for name in PART_TABLES:
        part = getattr(HardwareDesign(), name)
        hints = get_type_hints(type(part), include_extras=True)
        for field in fields(part):
            value, hint = getattr(part, field.name), hints[field.name]
            (limits,) = (get_args(hint)[0] if isinstance(value, tuple) else hint).__metadata__
            for end in (limits.ge, limits.le):
                several = value if isinstance(value, tuple) else (value,)
                ends = [(*several[:at], end, *several[at + 1 :]) for at in range(len(several))]
                found += [(name, field.name, each if isinstance(value, tuple) else end) for each in ends]
    return found


@settings(max_examples=2, deadline=None, suppress_health_check=list(HealthCheck))
@given(st.sampled_from(ends_of_ranges()))
def test_a_dimension_at_the_end_of_its_range_is_built_or_refused(end: tuple[str, str, object]) -> None:
    """Two of some two hundred in each run."""
    part, field, value = end
    design = HardwareDesign()
    try:
        sensor = BuildableDesign(replace(design, **{part: replace(getattr(design, part), **{field: value})}))
    except DesignImpossible as refused:
        assert "expected" in str(refused) and "got" in str(refused)
        return
    assert all(len(part.solid.solids()) == 1 and part.solid.is_valid for part in sensor.parts.values())
    assert sensor.interferences == []


@pytest.mark.parametrize(
    ("width", "height", "gel", "cols", "rows"),
    [(10, 10, 1.5, 5, 5), (60, 45, 5, 15, 11)],
)
def test_any_size_is_a_valid_assembly(width: float, height: float, gel: float, cols: int, rows: int) -> None:
    pitch = min(2.5, (width - 1.2) / (cols - 1), (height - 1.2) / (rows - 1))
    design = replace(sensor(width, height, gel), pin_board=PinBoard(rows, cols, pitch))
    far = change_design(HardwareDesign(design))
    sensor_of_size = BuildableDesign(far)
    assert all(len(part.solid.solids()) == 1 and part.solid.is_valid for part in sensor_of_size.parts.values())
    assert sensor_of_size.interferences == []
    require_agreement(sensor_of_size)

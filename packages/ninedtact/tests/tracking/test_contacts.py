"""Contacts of one reading and of a stream: their number, place and shape, and shares that add up to the whole wrench."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.mechanics.height_grid_indenter import indenter_from_heights
from ninedtact.mechanics.indenter import Indenter
from ninedtact.mechanics.pose import Pose
from ninedtact.quantities import Frame
from ninedtact.reading import Reading, read_frame
from ninedtact.shape.contacts import find_contacts
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.objects.height_fields import CoordinateGrid
from ninedtact.simulation.press import Press
from ninedtact.tracking import ContactTracker, SlipState

Presser = Callable[[Indenter, Pose, Press | None, int], tuple[Press, Reading]]


@pytest.fixture(scope="module")
def press(physical_sensor: SensorFolder) -> Presser:
    """Press an object on the twin and return the press and its reading with forces."""
    twin, shape, estimator = physical_sensor.twin(), physical_sensor.shape, physical_sensor.estimator("physics")
    reader = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))

    def press_and_read(indenter: Indenter, pose: Pose, last: Press | None, number: int) -> tuple[Press, Reading]:
        now = twin.press(last, indenter, pose) if pose.depth_mm > 0 else twin.hover(indenter, pose)
        frame = Frame(twin.renderer(now.corrected, number), round((number + 1) * 1e9 / 60), number)
        return now, estimator.add_force(read_frame(frame, shape, reader))

    return press_and_read


def two_balls(apart_mm: float, higher_mm: float) -> Indenter:
    """Two balls of 3 mm beside each other along x, the second one less deep."""
    grid = CoordinateGrid()
    heights = np.full(grid.x.shape, np.inf)
    for x_mm, up_mm in ((-apart_mm / 2, 0.0), (apart_mm / 2, higher_mm)):
        squared = (grid.x - x_mm) ** 2 + grid.y**2
        ball = 3 - np.sqrt(np.maximum(9 - squared, 0)) + up_mm
        heights = np.where(squared < 7, np.minimum(heights, ball), heights)
    return indenter_from_heights("two balls", heights, grid.pitch_mm)


def test_two_fingertips_are_two_contacts_whose_shares_add_up(press: Presser) -> None:
    true, reading = press(two_balls(9.0, 0.25), Pose(0.5, -0.4, 0.8), None, 0)
    found = reading.contacts
    assert len(found) == 2 and reading.wrench is not None
    assert [one.centre_mm for one in found] == [pytest.approx([x, -0.4], abs=0.25) for x in (-4.0, 5.0)]
    shares = [one.force.wrench.six for one in found if one.force is not None]
    assert sum(shares) == pytest.approx(reading.wrench.six, abs=1e-9)
    places, pressure = true.corrected.surface_points_mm, np.asarray(true.corrected.pressure_mpa)
    loads_n = [float(pressure[side].sum()) * 0.04 for side in (places[0] < 0.5, places[0] >= 0.5)]
    for share, load_n, one in zip(shares, loads_n, found, strict=True):
        assert share[2] == pytest.approx(-load_n, rel=0.1)
        assert one.force is not None and 0 < one.force.std[2] < load_n
    assert found[0].area_mm2 > found[1].area_mm2 and found[0].elongation < 1.2


def test_a_contact_has_the_outline_and_orientation_of_what_touches(press: Presser) -> None:
    _, reading = press(indenter_from_name("cylinder:2,8"), Pose(1.0, 0.5, 0.6, np.radians(30)), None, 0)
    (found,) = reading.contacts
    assert found.force is reading.force
    assert np.degrees(found.orientation_rad) == pytest.approx(30, abs=3) and found.elongation > 2
    x, y = (found.outline_mm - found.centre_mm).T
    enclosed_mm2 = 0.5 * abs(float(x @ np.roll(y, 1) - y @ np.roll(x, 1)))
    assert enclosed_mm2 == pytest.approx(found.area_mm2, rel=0.08)


def test_nothing_touches_no_contact(press: Presser) -> None:
    _, reading = press(indenter_from_name("ball:4"), Pose(depth_mm=-1.0), None, 0)
    assert reading.contacts == find_contacts(reading.height, np.zeros_like(reading.contact), reading.force) == ()
    nothing = ContactTracker().update(reading)
    assert nothing.contacts == nothing.slips == () and nothing.slip.state == SlipState.UNKNOWN


def test_contacts_keep_their_numbers_while_they_move_and_a_new_one_gets_another(press: Presser) -> None:
    tracker, last, balls = ContactTracker(), None, two_balls(9.0, 0.25)
    numbers = []
    # The second ball touches once the first is deep enough.
    for step, depth_mm in enumerate((0.2, 0.2, 0.6, 0.8, 0.8, 0.8)):
        last, reading = press(balls, Pose(0.3 * step, 0.0, depth_mm), last, step)
        found = tracker.update(reading)
        assert len(found.slips) == len(found.contacts)
        numbers.append([one.number for one in found.contacts])
    assert numbers == [[1], [1], [1, 2], [1, 2], [1, 2], [1, 2]]
    assert found.displacement_mm == pytest.approx([1.5, 0], abs=0.2)


def test_a_stamp_that_repeats_gives_an_unknown_slip(press: Presser) -> None:
    tracker, ball = ContactTracker(), indenter_from_name("ball:4")
    _, reading = press(ball, Pose(depth_mm=0.5), None, 0)
    assert tracker.update(reading).slip.state == SlipState.STATIC
    assert tracker.update(reading).slip.state == SlipState.UNKNOWN


def test_the_torque_of_a_twist_that_the_image_hides_is_seen_in_the_turn(press: Presser) -> None:
    """Also in a recording, which keeps the wrench but no tractions."""
    gear, last = indenter_from_name("gear_07"), None
    trackers = ContactTracker(), ContactTracker()
    turns_deg = (0, 0, 0, 2, 4, 6, 8)
    for number, (depth_mm, turn_deg) in enumerate(zip((0.1, 0.2, *[0.3] * 5), turns_deg, strict=True)):
        last, reading = press(gear, Pose(0.4, -0.3, depth_mm, np.radians(turn_deg)), last, number)
        assert reading.force is not None
        recorded = reading.with_force(replace(reading.force, traction=None))
        found = [tracker.update(one) for tracker, one in zip(trackers, (reading, recorded), strict=True)]
    assert last is not None and reading.force is not None
    true_nm, hidden_nm = last.wrench.torque_nm[2], reading.force.about_skin_centre().wrench.torque_nm[2]
    assert abs(hidden_nm) < 0.3 * true_nm
    for one in found:
        force = one.reading.force
        assert force is not None and force.std[5] < reading.force.std[5]
        assert one.contacts[0].force is (None if force.traction is None else force)
        assert force.wrench.torque_nm[2] == pytest.approx(true_nm, rel=0.4)
        assert one.slip.sticking_share == pytest.approx(1 - (last.slip_share or 0.0), abs=0.2)


def test_what_sticks_after_a_turn_is_not_forgotten_in_the_drag_that_follows(press: Presser) -> None:
    """A key bears friction of 1.0, twice what is expected of unknown things: its load along the skin tells this."""
    tracker, key, last = ContactTracker(), indenter_from_name("key_01"), None
    down = [Pose(0.3, -0.9, depth_mm) for depth_mm in (0.2, 0.4, 0.5, 0.5)]
    turned = [Pose(0.3, -0.9, 0.5, np.radians(turn_deg)) for turn_deg in (5, 10, 15, 20, 25, 30)]
    dragged = [Pose(0.3 + x_mm, -0.9, 0.5, np.radians(30)) for x_mm in (0.1, 0.2, 0.3)]
    for number, pose in enumerate(down + turned + dragged):
        last, reading = press(key, pose, last, number)
        found = tracker.update(reading)
        if pose in (turned[-1], dragged[-1]):
            assert last.slip_share is not None and found.slip.state == SlipState.INCIPIENT
            assert found.slip.sticking_share == pytest.approx(1 - last.slip_share, abs=0.3)

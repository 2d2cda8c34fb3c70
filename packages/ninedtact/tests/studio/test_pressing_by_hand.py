"""A person presses the twin on the page: what they set is what the simulation does, and what the page shows."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event

import numpy as np
import pytest
import trimesh
import viser
from height_observation import HeightObservationModel
from page_client import PageClient, ServedPage, served_page
from page_walk import controls_of, find_layout_faults, open_every_panel, panels_of, use_every_control
from playwright.sync_api import Browser, Page
from reading_clients import page_errors
from small_press_simulation import PRESSED, TWIN
from small_sensor import wait_until

from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.design import Gel
from ninedtact.errors import FileFormatError
from ninedtact.force.traction.estimator import TractionForce
from ninedtact.live.reading_recorder import RecordedSensorMetadata
from ninedtact.live.sensor_poller import SensorPoller
from ninedtact.live.wrench_history import WrenchHistory, WrenchPoller
from ninedtact.live_sensor import assemble_live_sensor
from ninedtact.mechanics.pose import Pose
from ninedtact.reading import Reading
from ninedtact.recording.reader import Recording
from ninedtact.recording.topics_and_messages import Topic
from ninedtact.simulation.ground_truth import true_height_map_like
from ninedtact.simulation.hand_moved_object import HandTarget, SimulatedHand
from ninedtact.simulation.objects.catalogue import indenter_from_name
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.simulation.simulated_sources import (
    NO_FORCE_TORQUE_ERRORS,
    DemoSources,
    SimulatedCamera,
    SimulatedForceTorque,
)
from ninedtact.studio.followed_object import ObjectFollower
from ninedtact.studio.page_controller import DisplayedSensor, PageMoment, SensorMoment
from ninedtact.studio.press_control import (
    TwinPressController,
    read_uploaded_mesh,
)
from ninedtact.studio.reading_view import ImageKind, ShownTraction
from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
from ninedtact.studio.saved_files import SaveQuota
from ninedtact.studio.sensor_group import grip_forces
from ninedtact.studio.twin_press_panel import HANDLE_LIFT_MM

PATIENCE_S = 120.0
HZ = 8.0
"""Steps per second of the twin, so that a busy machine keeps up."""


@dataclass
class PressedTwin(ServedPage):
    """A twin on a page, refreshed by the test."""

    control: TwinPressController

    @property
    def moment(self) -> PageMoment:
        moment = self.page.viewers[0].moment
        assert moment is not None
        return moment

    def rests_at(self, depth_mm: float) -> bool:
        self.refresh()
        if not self.page.viewers or self.page.viewers[0].moment is None:
            return False
        view = self.moment.sensors[0].view
        return view is not None and view.press is not None and abs(view.press.corrected.pose.depth_mm - depth_mm) < 1e-6


@contextmanager
def pressed_twin(
    folder: SensorFolder, out: Path, names: Sequence[str] = ("",), steps_hz: float = HZ
) -> Iterator[PressedTwin]:
    """A twin on a page, or several; the first one's control."""
    quota = SaveQuota()
    recorded = [RecordedSensorMetadata(folder, "twin", has_estimates=True, name=name) for name in names]
    recorder = quota.new_recorder(recorded, out)
    sensors: list[DisplayedSensor] = []
    with ExitStack() as opened:
        opened.callback(recorder.stop)
        for number, name in enumerate(names):
            simulation = PressSequence(TWIN, [PRESSED], steps_hz)
            sources = DemoSources(
                SimulatedCamera(simulation), SimulatedForceTorque(simulation, 60.0, NO_FORCE_TORQUE_ERRORS)
            )
            force = TractionForce(HeightObservationModel(), Gel(gel_to_base_modulus_ratio=0.0))
            live = assemble_live_sensor(folder, sources, follow_reference=False, estimator=force)
            estimated = WrenchHistory("estimated", "by physics", states_errors=True)

            follower = ObjectFollower(simulation.press_at)

            def keep(
                reading: Reading,
                number: int = number,
                estimated: WrenchHistory = estimated,
                follower: ObjectFollower = follower,
            ) -> None:
                assert reading.force is not None
                estimated.add_estimate(reading.force)
                recorder.add(reading, number)
                follower.add(reading)

            loop = opened.enter_context(SensorPoller(live.sensor, keep))
            true = opened.enter_context(WrenchPoller(sources.force_torque, "true", "of the simulation")).history
            sensors.append(DisplayedSensor(loop, [true, estimated], TwinPressController(simulation), name, follower))
        panel = partial(RecordingsPanel, context=RecordingsPanelContext(folder, recorder))
        served = opened.enter_context(served_page(sensors, out, [panel], quota))
        assert sensors[0].press is not None
        yield PressedTwin(served.server, served.controller, served.page, sensors[0].press)


def open_tab(browser: Browser, twin: PressedTwin, width: int, height: int) -> tuple[Page, list[str]]:
    tab = browser.new_page(viewport={"width": width, "height": height})
    errors = page_errors(tab)
    tab.set_default_timeout(PATIENCE_S * 1000)
    tab.goto(f"http://127.0.0.1:{twin.server.port}")
    wait_until(lambda: twin.page.is_watched, PATIENCE_S)
    twin.page.viewers[0].choose(coarser=4)  # a browser without a graphics card
    return tab, errors


def images_of(tab: Page) -> list[str | None]:
    return [image.get_attribute("src") for image in tab.locator("img[src^=blob]").all()]


def f_z_row(text: str) -> list[str]:
    """The cells of F_z in the table of wrenches on a page: its name, the true and the estimated force."""
    return next(line.split("\t") for line in text.splitlines() if line.startswith("Fz"))


def f_z_on_page(text: str) -> float:
    return float(f_z_row(text)[1].replace("\N{MINUS SIGN}", "-"))


def test_what_a_slider_sets_is_what_is_simulated_measured_and_shown(
    browser: Browser, tmp_path: Path, twin_sensor: SensorFolder
) -> None:
    with pressed_twin(twin_sensor, tmp_path) as twin:
        tab, errors = open_tab(browser, twin, 1300, 900)
        wait_until(lambda: (twin.refresh(), "ball_8mm" in tab.inner_text("body"))[1], PATIENCE_S, 0.05)
        twin.control.choose("primitives", "ball")
        wait_until(lambda: twin.rests_at(0.6), PATIENCE_S, 0.05)
        before = images_of(tab)
        depth = tab.locator("label:has-text('depth (mm)')").first.locator("xpath=ancestor::*[.//input][1]//input").last
        depth.fill("1.2")
        depth.press("Enter")
        wait_until(lambda: twin.rests_at(1.2), PATIENCE_S, 0.05)

        # The page may be some moments behind, and the samples of the wrench come from another thread.
        def the_page_shows_the_true_wrench() -> bool:
            if not twin.rests_at(1.2) or "1.20 mm deep" not in (text := tab.inner_text("body")):
                return False
            press = twin.moment.sensors[0].view.press  # type: ignore[union-attr]
            return f_z_on_page(text) == pytest.approx(press.corrected.wrench().force_n[2], abs=0.02)  # type: ignore[union-attr]

        wait_until(the_page_shows_the_true_wrench, PATIENCE_S, 0.05)
        said, (moment,) = tab.inner_text("body"), twin.moment.sensors
        view = moment.view
        assert view is not None and view.press is not None and moment.reading is not None
        true = true_height_map_like(
            view.press.corrected, moment.reading.height, TWIN.renderer.light.inverse_distance_per_mm
        )
        # This sensor is calibrated by the method that is done soonest, which reads deep presses too deep.
        assert moment.reading.max_indentation_mm == pytest.approx(-true.z_mm.min(), abs=0.25)
        assert np.corrcoef(moment.reading.height.z_mm.ravel(), true.z_mm.ravel())[0, 1] > 0.97
        shown = re.search(r"maximum indentation\s*([\d.]+)", said)
        assert shown is not None and float(shown[1]) == pytest.approx(moment.reading.max_indentation_mm, abs=0.03)
        assert moment.followed.seen is not None and moment.followed.true is not None
        assert re.search(r"(no|incipient|gross) slip\s+x mm\s+y mm\s+turn\s+sticks\s+● estimated\s.*\s+● true\s", said)
        force_n = float(view.press.corrected.wrench().force_n[2])
        assert f_z_on_page(said) == pytest.approx(force_n, abs=0.02)
        estimate, std = re.findall(r"[\d.]+", f_z_row(said)[2])
        # Its force is off by a third, which the stated error, that of a sensor calibrated by physics, does not include.
        assert -float(estimate) == pytest.approx(force_n, abs=4 * float(std) + 0.4 * abs(force_n))
        assert len(before) == 2 and not set(before) & set(images_of(tab))
        assert tab.title() == "small · 9DTact" and "true" in said and "estimated" in said
        assert tab.evaluate("document.documentElement.scrollWidth <= innerWidth")
    assert errors == []


PANELS = ("Images", "Press", "View", "Profile", "Record", "Sensor", "Wrench")


def test_every_control_can_be_used_and_nothing_is_outside_or_covered(
    browser: Browser, tmp_path: Path, twin_sensor: SensorFolder, capfd: pytest.CaptureFixture[str]
) -> None:
    used, faults = set[str](), list[str]()
    with pressed_twin(twin_sensor, tmp_path, steps_hz=2.0) as twin:  # which leaves the computer to the browser

        def refresh() -> None:
            twin.refresh()

        def until_ready(tab: Page) -> None:
            wait_until(lambda: refresh() or set(PANELS) <= set(panels_of(tab)), PATIENCE_S, 0.05)

        phone, phone_errors = open_tab(browser, twin, 390, 844)
        until_ready(phone)
        open_every_panel(phone, refresh, lambda name: faults.extend(find_layout_faults(phone)))
        phone.close()
        tab, errors = open_tab(browser, twin, 1300, 900)
        until_ready(tab)
        wait_until(lambda: refresh() or "ball_8mm" in tab.inner_text("body"), PATIENCE_S, 0.05)
        twin.page.viewers[-1].choose(coarser=4)

        def has_recorded_images() -> bool:
            with Recording(next(tmp_path.glob("*.mcap"))) as recording:
                return len(recording.positions(Topic.IMAGES)) > 0

        def has(name: str) -> Callable[[], bool]:
            return lambda: name in [control["name"] for control in controls_of(tab)]

        last = {
            "Record": (lambda: True, has("Stop recording")),
            "Stop recording": (has_recorded_images, has("Record")),
            "recording": (lambda: True, has("Back to the sensor")),
            "Back to the sensor": (lambda: True, lambda: not has("Back to the sensor")()),
        }

        def use_panel(name: str) -> None:
            faults.extend(find_layout_faults(tab))
            use_every_control(tab, refresh, used, last)
            faults.extend(find_layout_faults(tab))

        open_every_panel(tab, refresh, use_panel)
    assert faults == [] and errors == [] and phone_errors == []
    assert "Traceback" not in "".join(capfd.readouterr())
    assert {"button|Back to the sensor|1", "button|Video (MP4)|1", "button|Add label|1", "slider|twist (°)|1"} <= used


def drag_handle(hand: PageClient, position_mm: Sequence[float], twist_rad: float = 0.0) -> None:
    """Take the handle, move it and let it go, as a browser says it."""
    wxyz = tuple(viser.transforms.SO3.from_matrix(Pose(0, 0, 0, twist_rad).rotation).wxyz.tolist())
    hand.drag_handle(tuple(map(float, position_mm)), wxyz)
    hand.end_drag()


def test_a_drag_is_followed_where_the_object_comes_late(
    tmp_path: Path, twin_sensor: SensorFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pressed_twin(twin_sensor, tmp_path) as twin, twin.viewer() as (hand, viewer):
        wait_until(lambda: (twin.refresh(), viewer.moment is not None)[1], PATIENCE_S)
        move, may_move, waiting = twin.control.move, Event(), []

        def move_late(**changes: float) -> None:
            waiting.append(changes)
            may_move.wait(PATIENCE_S)
            move(**changes)

        monkeypatch.setattr(twin.control, "move", move_late)
        for x_mm in (0.5, 1.5):
            drag_handle(hand, (x_mm, -1.0, HANDLE_LIFT_MM - 0.9))
        wait_until(lambda: bool(waiting))
        hand.socket.ping().wait(PATIENCE_S)  # both drags have arrived
        sent = len(hand.messages)
        twin.refresh()  # would put the handle back to the object, which has not moved yet
        may_move.set()
        wait_until(lambda: (twin.control.state.x_mm, twin.control.state.depth_mm) == pytest.approx((1.5, 0.9)))
        twin.control.move(x_mm=-2.0)

        def handle_is_at(x_mm: float) -> bool:
            twin.refresh()
            places = [one["position"] for one in hand.messages[sent:] if one["type"] == "SetPositionMessage"]
            return any(place[0] == pytest.approx(x_mm) for place in places)

        wait_until(lambda: handle_is_at(-2.0), PATIENCE_S)
        assert not handle_is_at(0.0)


def test_two_twins_close_on_an_object_like_a_gripper(tmp_path: Path, twin_sensor: SensorFolder) -> None:
    with (
        pressed_twin(twin_sensor, tmp_path, ("left", "right")) as twin,
        twin.viewer() as (hand, viewer),
    ):
        wait_until(
            lambda: (twin.refresh(), viewer.moment is not None and viewer.moment.sensors[0].view)[1],
            PATIENCE_S,
        )
        x, y, z = viewer.arrangement.places_mm[0]
        drag_handle(hand, (x + 1.5, y - 1.0, z + HANDLE_LIFT_MM - 0.9))

        def both_rest() -> bool:
            twin.refresh()
            assert viewer.moment is not None
            views = [one.view for one in viewer.moment.sensors]
            poses = [None if view is None or view.press is None else view.press.corrected.pose for view in views]
            return len(poses) == 2 and all(
                pose is not None and pose.depth_mm == pytest.approx(0.9) and pose.x_mm == pytest.approx(1.5)
                for pose in poses
            )

        wait_until(
            lambda: both_rest() and all(shows_the_true_wrench(one) for one in viewer.moment.sensors), PATIENCE_S, 0.01
        )
        assert viewer.moment is not None
        forces_n = [
            [-one.sample.wrench.force_n[2] for one in each.wrenches if one.sample] for each in viewer.moment.sensors
        ]
        true, estimated = grip_forces(viewer.moment.sensors)
        means_n = np.mean(forces_n, axis=0)
        assert (true.force_n, estimated.force_n) == pytest.approx(tuple(means_n)) and means_n[0] > 1.0
        assert abs(means_n[1] - means_n[0]) < 4 * estimated.std_n
        viewer.choose(sensor=1)
        twin.refresh()
        drag_handle(hand, (0.0, 0.0, HANDLE_LIFT_MM - 0.4))

        def only_the_right_is_pressed_less() -> bool:
            twin.refresh()
            assert viewer.moment is not None
            presses = [one.view.press for one in viewer.moment.sensors if one.view is not None and one.view.press]
            return [round(press.corrected.pose.depth_mm, 3) for press in presses] == [0.9, 0.4]

        wait_until(only_the_right_is_pressed_less, PATIENCE_S, 0.01)


def shows_the_true_wrench(moment: SensorMoment) -> bool:
    if moment.view is None or moment.view.press is None or moment.wrenches[0].sample is None:
        return False
    true = moment.view.press.corrected.wrench().six
    return bool(moment.wrenches[0].sample.wrench.six == pytest.approx(true, rel=0.02, abs=0.02))


def test_the_handle_of_one_viewer_moves_the_object_of_all_and_freezing_is_each_viewers_own(
    tmp_path: Path, twin_sensor: SensorFolder
) -> None:
    with (
        pressed_twin(twin_sensor, tmp_path) as twin,
        twin.viewer() as (hand, first),
        twin.viewer() as (_, second),
    ):

        def both_see_the_skin() -> bool:
            twin.refresh()
            return all(one.moment is not None and one.moment.sensors[0].view for one in (first, second))

        wait_until(both_see_the_skin, PATIENCE_S)
        second.toggle_freeze()
        assert first.moment is not None and second.moment is not None
        (kept,) = second.moment.sensors
        assert second.is_frozen and not first.is_frozen
        drag_handle(hand, (1.5, -1.0, HANDLE_LIFT_MM - 0.9), twist_rad=0.1)
        # The samples of the wrench come from another thread, so the last step of the motion may reach them a moment later.
        wait_until(lambda: twin.rests_at(0.9) and shows_the_true_wrench(first.moment.sensors[0]), PATIENCE_S, 0.01)
        (moment,) = first.moment.sensors
        assert moment.view is not None and moment.view.press is not None
        pose = moment.view.press.corrected.pose
        assert (pose.x_mm, pose.y_mm, pose.twist_rad) == pytest.approx((1.5, -1.0, 0.1), abs=1e-3)
        (frozen,) = second.moment.sensors
        assert frozen.reading is kept.reading and frozen.wrenches is kept.wrenches
        assert frozen.snapshot is kept.snapshot and frozen.status.sentence.startswith("frozen: the moment shown is ")
        assert moment.status.tone == "live"
        second.choose(images=(ImageKind.GEL_FLOW, ImageKind.STICKING), source=ShownTraction.TRUE, pressure_arrows=True)
        twin.refresh()
        assert second.moment.sensors[0].reading is kept.reading
        assert first.options.images != second.options.images
        second.toggle_freeze()

        def both_show_the_same() -> bool:
            twin.refresh()
            return second.moment.sensors[0].reading is first.moment.sensors[0].reading  # type: ignore[union-attr]

        wait_until(both_show_the_same, PATIENCE_S, 0.01)  # a client that is behind is left out for some moments


def test_a_hand_holds_depth_load_and_place_and_a_refused_step_leaves_the_object() -> None:
    hand = SimulatedHand()
    stage = PressSequence(TWIN, [PRESSED], 10.0, real_time=False, hand=hand)
    hand.take(indenter_from_name("ball:4"))
    hand.aim(HandTarget(Pose(0.0, 0.0, 0.8)))
    pressed = stage.contact(8)
    assert pressed.pose.depth_mm == pytest.approx(0.8) and pressed.wrench().force_n[0] == pytest.approx(0, abs=0.02)
    hand.aim(HandTarget(Pose(1.0, 0.0, 0.8)))
    dragged = stage.contact(16)
    assert dragged.pose.x_mm == pytest.approx(1.0) and dragged.wrench().force_n[0] > 0.5
    hand.aim(HandTarget(Pose(1.0, 0.0), load_n=6.0))
    assert stage.contact(24).wrench().force_n[2] == pytest.approx(-6.0, rel=0.01)
    hand.aim(HandTarget(Pose(1.0, 0.0, 9.0)))
    stopped = stage.contact(60)
    assert float(stopped.pose.depth_mm) < TWIN.gel.max_depth_mm and "press less" in hand.refusal
    hand.aim(HandTarget(Pose(1.0, 0.0), load_n=0.0))
    assert not stage.contact(80).touches and hand.refusal == ""
    hand.release()
    press = stage.press_at(stage.clock.start_ns + round(81e9 / 10))
    assert press is None and stage.contact(81) is not None
    press = stage.press_at(stage.clock.start_ns + round(81e9 / 10))
    assert press is not None and press.indenter is PRESSED.indenter


def test_what_is_refused_to_move_can_be_lifted() -> None:
    hand = SimulatedHand()
    stage = PressSequence(TWIN, [PRESSED], 10.0, real_time=False, hand=hand)
    hand.take(indenter_from_name("ball:4"))
    hand.aim(HandTarget(Pose(11.0, 0.0, 0.8)))
    stage.contact(8)
    hand.aim(HandTarget(Pose(40.0, 0.0, 0.8)))
    assert stage.contact(30).touches and "nearer to the centre" in hand.refusal
    hand.aim(HandTarget(Pose(40.0, 0.0, -0.5)))
    assert not stage.contact(40).touches


def stl(mesh: trimesh.Trimesh) -> bytes:
    return bytes(mesh.export(file_type="stl"))


def open_box() -> trimesh.Trimesh:
    box = trimesh.creation.box((6, 4, 3))
    return trimesh.Trimesh(box.vertices, box.faces[:-1], process=False)


@pytest.mark.parametrize(
    ("name", "content", "because"),
    [
        ("huge.stl", bytes(17_000_000), "at most 16 MB ending in .stl or .obj"),
        ("part.exe", b"x", "ending in .stl or .obj"),
        ("empty.stl", b"", "of 0 MB"),
        ("broken.stl", b"solid x\nfacet normal", "got"),
        ("open.stl", stl(open_box()), "edges that belong to one triangle only"),
        ("tiny.stl", stl(trimesh.creation.box((1e-4, 1e-4, 1e-4))), "in millimetres, larger than 1 mm"),
        (
            "wide.stl",
            stl(trimesh.creation.box((500, 4, 3))),
            "across, got 500 x 4 x 3 mm; choose another unit, 'fit to 16 mm',",
        ),
    ],
)
def test_a_mesh_that_cannot_be_pressed_is_refused_in_one_sentence(name: str, content: bytes, because: str) -> None:
    with pytest.raises(FileFormatError) as refusal:
        read_uploaded_mesh(name, content)
    said = str(refusal.value)
    assert "give " not in said  # which is how objects are named on the command line
    assert because in said and "\n" not in said and "/tmp" not in said and said.startswith("expected ")


def test_a_mesh_of_ones_own_is_pressed() -> None:
    control = TwinPressController(PressSequence(TWIN, [PRESSED]))
    said = control.upload("../../my part.obj", trimesh.creation.box((6, 4, 3)).export(file_type="obj").encode())
    assert said == "my_part: 6.0 x 4.0 x 3.0 mm, 12 triangles" and control.own_mesh is not None
    assert control.own_mesh.name == "my_part"
    assert control.simulation.hand.held_object is not None

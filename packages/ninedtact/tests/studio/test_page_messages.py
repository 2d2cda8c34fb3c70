"""What browsers send is tested before the page gets it: values that no person could choose reach no control."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import msgspec
import pytest
from page_client import page_socket
from reading_clients import CAMERA
from small_calibrated_twin import TWIN as CALIBRATED_TWIN
from small_calibrated_twin import PluggedCamera
from small_press_simulation import PRESSED, TWIN
from small_sensor import SHAPE, SkinCamera, sensor_folder, sensor_on, wait_until
from viser import ViserServer

from ninedtact.calibration.sensor_folder import load_sensor
from ninedtact.design import Gel, SensorDesign
from ninedtact.simulation.press_sequence import PressSequence
from ninedtact.studio.calibration_page import CalibrationPage
from ninedtact.studio.calibration_session import CalibrationSession
from ninedtact.studio.guided_session import SwitchableCamera
from ninedtact.studio.page_and_server import SensorPage, page_server
from ninedtact.studio.page_controller import DisplayedSensor, PageController
from ninedtact.studio.page_messages import has_no_effect, is_page_message
from ninedtact.studio.page_recorder import PageRecorder, PageSensorToRecord
from ninedtact.studio.press_control import TwinPressController
from ninedtact.studio.recordings_panel import RecordingsPanel, RecordingsPanelContext
from ninedtact.studio.scene_3d import gel_block_under_skin
from ninedtact.studio.sensor_poller import SensorPoller
from ninedtact.studio.socket_guard import SocketGuard, SocketLimits

JUNK: tuple[Any, ...] = (
    *(None, False, True, 0, -1, 7, 0.5, 1e9, -1e9, 1e300, float("nan"), float("inf"), 2**63),
    *("", "0", "nope", "x" * 300, "\x00", b"", {}, {"value": 1}),
    *([], [0.0], [0.0, 0.0], [1e9, -1e9], [0.0, float("nan")], ["", ""], [0.0] * 3),
)

Kind = tuple[type, ...]


def update(uuid: str, value: Any) -> bytes:
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": uuid, "updates": {"value": value}})


def test_a_control_gets_values_of_its_kind_within_its_limits() -> None:
    with page_server("127.0.0.1", 0) as server:
        gui = server.gui
        number: Kind = (int, float)
        cases: list[tuple[Any, Kind, list[Any], list[Any]]] = [
            (gui.add_button("press"), (), [True], []),
            (gui.add_button_group("choose", ("a", "b")), (), ["a", "b"], []),
            (gui.add_dropdown("choose", ("a", "b")), (), ["a", "b"], []),
            (gui.add_checkbox("check", False), (bool,), [True, False], []),
            (gui.add_text("say", ""), (str,), ["", "words"], []),
            (gui.add_slider("slide", -8.0, 8.25, 0.5, 0.0), number, [-8, 0.5, 8.25], [-8.01, 8.3, 1e9]),
            (gui.add_slider("count", 1, 5, 1, 1), number, [1, 5], [0, 0.5, 6]),
            (gui.add_number("type", 1.0, min=0.5, step=0.1), number, [0.5, 1e6], [0.0, -1.0]),
            (gui.add_number("type", 1.0), number, [-1e9, 1e9], []),
            (
                gui.add_vector2("place", (0.0, 0.0), min=(-1.0, -2.0), max=(1.0, 2.0), step=0.1),
                (list,),
                [[1, 2]],
                [[1.5, 0], [0, -2.1]],
            ),
            (gui.add_progress_bar(0.0), (), [], []),
            (gui.add_upload_button("upload"), (), [], []),
        ]
        for control, kind, possible, beyond in cases:
            uuid, find = control._impl.uuid, {control._impl.uuid: control}.get
            for value in (*possible, *beyond):
                assert is_page_message(update(uuid, value), find), (control, value)
                assert has_no_effect(update(uuid, value), find) == (value in beyond), (control, value)
            for value in JUNK:
                is_possible = type(value) in kind or (value is True and control._impl.is_button)
                assert is_possible or not is_page_message(update(uuid, value), find), (control, value)


def test_a_control_that_is_hidden_or_disabled_cannot_be_used() -> None:
    with page_server("127.0.0.1", 0) as server:
        hidden, disabled = (
            server.gui.add_button("hidden", visible=False),
            server.gui.add_checkbox("off", False, disabled=True),
        )
        shown = server.gui.add_button("shown")
        find = {one._impl.uuid: one for one in (hidden, disabled, shown)}.get
        for control, has_effect in ((hidden, False), (disabled, False), (shown, True)):
            assert has_no_effect(update(control._impl.uuid, True), find) != has_effect  # type: ignore[attr-defined]
        hidden.visible = True
        assert not has_no_effect(update(hidden._impl.uuid, True), find)


def test_a_file_is_taken_by_the_button_for_it_only() -> None:
    with page_server("127.0.0.1", 0) as server:
        button, slider = server.gui.add_upload_button("upload"), server.gui.add_slider("slide", 0.0, 1.0, 0.1, 0.0)
        find = {one._impl.uuid: one for one in (button, slider)}.get
        for control, is_taken in ((button, True), (slider, False)):
            of = {"source_component_uuid": control._impl.uuid, "transfer_uuid": "t"}  # type: ignore[attr-defined]
            start = {"type": "FileTransferStartUpload", "filename": "a", "mime_type": "", "part_count": 1}
            part = {"type": "FileTransferPart", "part_index": 0, "content": b"a"}
            for message in (start | of | {"size_bytes": 1}, part | of):
                assert is_page_message(msgspec.msgpack.encode(message), find) == is_taken


@contextmanager
def live_page(server: ViserServer, out: Path) -> Iterator[Callable[[], Any]]:
    """The page of a twin that is pressed by hand and recorded."""
    with SensorPoller(sensor_on(SkinCamera())) as poller:
        controller = PageController(
            [DisplayedSensor(poller, press=TwinPressController(PressSequence(TWIN, [PRESSED])))], out
        )
        folder = load_sensor(sensor_folder(out / "sensor"))
        recorder = PageRecorder([PageSensorToRecord(folder, "bench", [])], out, controller.quota)
        panel = partial(RecordingsPanel, context=RecordingsPanelContext(server, folder, recorder))
        page = SensorPage(server, controller, gel_block_under_skin(SHAPE, Gel()), "small", [panel])
        yield lambda: controller.refresh(page)
        recorder.stop()


@contextmanager
def calibration_page(server: ViserServer, out: Path) -> Iterator[Callable[[], Any]]:
    """The page of a guided calibration."""
    camera = PluggedCamera(CALIBRATED_TWIN, SensorDesign(), rate_hz=60.0)
    with CalibrationSession(SwitchableCamera(lambda address: camera, "sim"), out / "s") as session:
        yield CalibrationPage(server, session, lambda: {"sim": "simulated sensor"}, camera).refresh


@pytest.mark.parametrize(("page", "expected"), [(live_page, 50), (calibration_page, 15)])
def test_junk_for_every_control_disturbs_no_page(
    page: Any, expected: int, tmp_path: Path, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    patient = SocketGuard("127.0.0.1", limits=SocketLimits(messages_per_s=1_000_000))
    with ExitStack() as opened:
        server = opened.enter_context(page_server("127.0.0.1", 0, patient))
        refresh = opened.enter_context(page(server, tmp_path))
        with page_socket(server.get_port()) as junk, page_socket(server.get_port()) as other:

            def controls() -> list[Any]:
                pages = [server.gui, *(client.gui for client in server.get_clients().values())]
                return [one for gui in pages for one in gui._gui_input_handle_from_uuid.values()]

            def themes() -> list[Any]:
                return [one for one in controls() if getattr(one, "label", None) == "dark"]

            wait_until(lambda: (refresh(), len(themes()) == 2)[1])
            every = controls()
            assert len(every) >= expected
            for number, control in enumerate(every):
                for value in JUNK:
                    # A button does what it says, and would begin the next step of the page.
                    if not (value is True and control._impl.is_button):
                        junk.send(update(control._impl.uuid, value))
                part = {"source_component_uuid": control._impl.uuid, "transfer_uuid": "t", "part_index": 0}
                junk.send(msgspec.msgpack.encode({"type": "FileTransferPart", "content": b"x"} | part))
                if number % 10 == 0:
                    refresh()
            nothing = {"wxyz": (0.0,) * 4, "position": (1e9,) * 3}
            junk.send(msgspec.msgpack.encode(CAMERA | nothing | {"image_height": -1, "image_width": 1e9}))
            handle = {"type": "TransformControlsUpdateMessage", "name": "/press/handle", "owner": ""}
            junk.send(msgspec.msgpack.encode(handle | nothing))
            # Each browser has its own control, and the last of these messages is handled after all the junk.
            for theme, value in product(themes(), (True, False)):
                junk.send(update(theme._impl.uuid, value))
                other.send(update(theme._impl.uuid, value))
                wait_until(lambda theme=theme, value=value: theme.value is value)
            time.sleep(0.2)  # what the controls do, they do in other threads
            refresh()
            for control in every:
                options, limits = getattr(control, "options", None), getattr(control, "min", None)
                assert options is None or control.value in options
                usable = getattr(control, "visible", True) and not getattr(control, "disabled", False)
                assert (
                    limits is None
                    or not usable
                    or not has_no_effect(update(control._impl.uuid, control.value), {control._impl.uuid: control}.get)
                )
            assert len(server.get_clients()) == 2
    assert len(caplog.messages) == 1 and "dropped a message of" in caplog.messages[0]
    assert "Traceback" not in capfd.readouterr().err

"""ROS 2 messages reach another process, as Cyclone DDS itself reads them. `make test-interop` runs this."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Event, Thread, Timer
from typing import Any

import numpy as np
import pytest
from small_sensor import RECORDED, SkinCamera, image_folder, sensor_folder, sensor_on, wait_until

from ninedtact.calibration.sensor_folder import SensorFolder, load_sensor
from ninedtact.capture.frame_source import SourceNotOpen
from ninedtact.capture.reconnecting import ReconnectingFrameSource
from ninedtact.capture.wrench_source import WrenchSource
from ninedtact.force.estimator_and_scale import ForceEstimator, NoForceEstimator

pytestmark = pytest.mark.interop
pytest.importorskip("cyclonedds", reason="expected cyclonedds, got none; pip install 'ninedtact[ros2]'")

from ninedtact.interop.dds import (  # noqa: E402
    DdsParticipant,
    DdsReader,
    cyclonedds_configuration,
    parse_qos,
)
from ninedtact.interop.ros2_sensor import SensorOnRos2  # noqa: E402
from ninedtact.interop.ros2_topics_and_messages import (  # noqa: E402
    CONTACTS,
    LIVE_TOPICS,
    POINTS,
    SLIP,
    STRING_TYPE,
    TF,
    TF_STATIC,
    TF_TYPE,
    QosProfile,
    SensorMessages,
)
from ninedtact.mechanics.pose import Pose  # noqa: E402
from ninedtact.quantities import Frame, Wrench  # noqa: E402
from ninedtact.reading import read_frame  # noqa: E402
from ninedtact.recording.reader import Recording  # noqa: E402
from ninedtact.recording.topics_and_messages import Topic, encode_message, type_store  # noqa: E402
from ninedtact.simulation.objects.catalogue import indenter_from_name  # noqa: E402

DOMAIN, INTERFACE = 101, "lo"
ENVIRONMENT = os.environ | {"CYCLONEDDS_URI": cyclonedds_configuration(INTERFACE)}


@dataclass
class Running:
    """A sensor on ROS 2 in this process, and what the test speaks to it with."""

    participant: DdsParticipant
    camera: SkinCamera
    shared: SensorOnRos2
    command: Callable[[str], None]
    status: DdsReader
    sentences: list[str]
    """What a terminal is told."""
    stop: Callable[[], None]
    """Ends the thread that reads and publishes; a test may publish readings of its own then."""

    def statuses(self, reader: DdsReader | None = None) -> list[dict[str, Any]]:
        texts = [type_store().deserialize_cdr(cdr, STRING_TYPE).data for cdr in (reader or self.status).take()]
        return [json_of(text) for text in texts]

    def until_status(self, is_wanted: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
        found: list[dict[str, Any]] = []
        wait_until(lambda: bool(found.extend(filter(is_wanted, self.statuses())) or found))
        return found[0]

    def answer(self, command: str) -> dict[str, Any]:
        self.command(command)
        return self.until_status(lambda status: status.get("command") == command)


def json_of(text: str) -> dict[str, Any]:
    import json

    parsed: dict[str, Any] = json.loads(text)
    return parsed


@contextmanager
def sensor_on_ros2(
    folder: SensorFolder,
    out: Path,
    period_s: float = 0.01,
    measured: WrenchSource | None = None,
    estimator: ForceEstimator = NoForceEstimator(),
) -> Iterator[Running]:
    camera, over = SkinCamera(period_s), Event()
    with DdsParticipant(DOMAIN, INTERFACE) as participant:
        messages = SensorMessages(folder, "small", points_every=1)
        sensor = sensor_on(ReconnectingFrameSource(camera, on_lost=lambda loss: None, retry_ms=20.0))
        sensor.estimator, sensor.references.find_faults = estimator, lambda _: ["unlike the calibration"]
        profiles, sentences = parse_qos(()), list[str]()
        shared = SensorOnRos2(sensor, messages, participant, profiles, out, measured, "of the bench", sentences.append)
        thread = Thread(target=shared.run, args=(over.is_set,))
        thread.start()

        def stop() -> None:
            over.set()
            thread.join()

        writer = participant.writer("/small/command", STRING_TYPE, QosProfile.RELIABLE)
        status = participant.reader("/small/status", STRING_TYPE, QosProfile.LATCHED)
        try:
            wait_until(lambda: shared.published > 0 and writer.has_subscribers)
            command = lambda text: writer.write(encode_message(STRING_TYPE, data=text))  # noqa: E731
            yield Running(participant, camera, shared, command, status, sentences, stop)
        finally:
            stop()


def test_cyclones_tools_list_the_topics_with_their_types_and_print_messages(tmp_path: Path) -> None:
    with sensor_on_ros2(load_sensor(sensor_folder(tmp_path / "small")), tmp_path):
        tool = [str(Path(sys.executable).with_name("cyclonedds"))]
        options = ["--id", str(DOMAIN), "--color", "none", "--runtime", "4"]
        listed = subprocess.run(
            [*tool, "ls", *options], capture_output=True, text=True, env=ENVIRONMENT | {"COLUMNS": "200"}
        )
        for topic, (message_type, _) in LIVE_TOPICS.items():
            assert f"rt/small/{topic}" in listed.stdout, listed.stdout + listed.stderr
            package, _, name = message_type.split("/")
            assert re.search(rf"{package}::msg::dds_::{name}_", listed.stdout)
        subscribe = [*tool, "subscribe", "rt/small/status", *options]
        with subprocess.Popen(subscribe, stdout=subprocess.PIPE, text=True, env=ENVIRONMENT) as printing:
            assert printing.stdout is not None
            Timer(60, printing.kill).start()
            assert any('"sensor": "small"' in line for line in printing.stdout)
            printing.kill()


def test_the_program_without_ros_reads_heights_and_is_answered(tmp_path: Path) -> None:
    program = (Path(__file__).parents[4] / "examples" / "ros2" / "read_without_ros.py").read_text(encoding="utf-8")
    program = program.replace("/twin/", "/small/").replace("DomainParticipant(0)", f"DomainParticipant({DOMAIN})")
    with sensor_on_ros2(load_sensor(sensor_folder(tmp_path / "small")), tmp_path):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, env=ENVIRONMENT)
    assert done.returncode == 0, done.stderr
    heights, answer = done.stdout.splitlines()
    assert heights.startswith("small_skin (") and '"command": "take_reference", "ok": true' in answer


def test_images_points_and_transforms_arrive_whole(tmp_path: Path) -> None:
    with sensor_on_ros2(load_sensor(sensor_folder(tmp_path / "small")), tmp_path) as running:
        make = running.participant.reader
        images = make("/small/image_raw", LIVE_TOPICS[Topic.IMAGES][0], QosProfile.SENSOR_DATA)
        points = make("/small/points", LIVE_TOPICS[POINTS][0], QosProfile.RELIABLE)
        transforms = make(TF_STATIC, TF_TYPE, QosProfile.LATCHED)
        late = make("/small/reference_grey", LIVE_TOPICS[Topic.REFERENCE_GREY][0], QosProfile.LATCHED)
        found: dict[str, bytes] = {}
        for name, reader in (("image", images), ("points", points), ("tf", transforms), ("reference", late)):
            wait_until(lambda name=name, reader=reader: bool([found.setdefault(name, cdr) for cdr in reader.take()]))  # type: ignore[misc]
    image = type_store().deserialize_cdr(found["image"], LIVE_TOPICS[Topic.IMAGES][0])
    assert (image.width, image.height, image.encoding, len(image.data)) == (64, 48, "bgr8", 64 * 48 * 3)
    reference = type_store().deserialize_cdr(found["reference"], LIVE_TOPICS[Topic.REFERENCE_GREY][0])
    assert (reference.encoding, reference.header.frame_id) == ("32FC1", "small_skin")
    assert np.frombuffer(reference.data, "<f4").reshape(reference.height, reference.width).mean() > 20
    assert type_store().deserialize_cdr(found["points"], LIVE_TOPICS[POINTS][0]).width == 30 * 40
    frames = [each.child_frame_id for each in type_store().deserialize_cdr(found["tf"], TF_TYPE).transforms]
    assert frames == ["small_camera_optical", "small_gel"]


def test_contacts_slip_and_the_frame_of_the_object_arrive(tmp_path: Path, physical_sensor: SensorFolder) -> None:
    twin, shape = physical_sensor.twin(), physical_sensor.shape
    untouched = shape.depth_reader(*(Frame(twin.renderer(None, -1 - number)) for number in range(4)))
    press = twin.press(None, indenter_from_name("key_05"), Pose(depth_mm=0.5))
    key = read_frame(Frame(twin.renderer(press.corrected, 1), 10**9), shape, untouched)
    with sensor_on_ros2(load_sensor(sensor_folder(tmp_path / "small")), tmp_path) as running:
        make = running.participant.reader
        contacts, slip = (make(f"/small/{topic}", STRING_TYPE, QosProfile.RELIABLE) for topic in (CONTACTS, SLIP))
        frames = make(TF, TF_TYPE, QosProfile.RELIABLE)
        found: dict[str, bytes] = {}
        running.stop()

        def arrives(name: str, reader: Any) -> bool:
            running.shared.publish(key)
            return bool([found.setdefault(name, cdr) for cdr in reader.take()])

        for name, reader in (("frame", frames), ("contacts", contacts), ("slip", slip)):
            wait_until(partial(arrives, name, reader), pause_s=0.1)
    (transform,) = type_store().deserialize_cdr(found["frame"], TF_TYPE).transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("small_skin", "small_object")
    assert "contacts" in json.loads(type_store().deserialize_cdr(found["contacts"], STRING_TYPE).data)
    assert "p_gross" in json.loads(type_store().deserialize_cdr(found["slip"], STRING_TYPE).data)


class Samples(WrenchSource):
    """A force/torque sensor of 500 samples per second, whose n-th sample pulls with n N."""

    name = "samples"

    def open(self) -> None:
        self.is_open, self._count = True, 0

    def close(self) -> None:
        self.is_open = False

    def read(self) -> Wrench:
        time.sleep(0.002)
        if not self.is_open:
            raise SourceNotOpen(self.name)
        self._count += 1
        return Wrench(np.array([0.0, 0.0, self._count]), np.zeros(3), stamp_ns=time.monotonic_ns())


def test_every_sample_of_a_force_torque_sensor_is_published_and_recorded(tmp_path: Path) -> None:
    device, message_type = Samples(), LIVE_TOPICS[Topic.MEASURED][0]
    folder = load_sensor(sensor_folder(tmp_path / "small"))
    with sensor_on_ros2(folder, tmp_path, measured=device) as running:
        reader = running.participant.reader("/small/wrench_measured", message_type, QosProfile.RELIABLE)
        found: list[Any] = []

        def collect() -> bool:
            found.extend(type_store().deserialize_cdr(cdr, message_type) for cdr in reader.take())
            return len(found) > 100

        assert running.answer("start_recording both")["ok"]
        wait_until(collect)
        assert running.answer("stop_recording")["ok"]
    assert not device.is_open
    forces = [one.wrench.force.z for one in found]
    assert forces == sorted(set(forces)) and {one.header.frame_id for one in found} == {"small_skin"}
    stamps_s = [one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in found]
    assert abs(stamps_s[-1] - time.time()) < 60
    with Recording(tmp_path / "both.mcap") as recording:
        recorded = [wrench.force_n[2] for wrench in recording.wrenches()]
    assert len(recorded) > 50 and np.all(np.diff(recorded) == 1)


def test_commands_are_answered_and_a_recording_opens(tmp_path: Path) -> None:
    out = tmp_path / "recordings"
    with sensor_on_ros2(load_sensor(sensor_folder(tmp_path / "small")), out) as running:
        assert running.answer("take_reference")["ok"]
        begun = running.answer("start_recording press")
        assert (begun["ok"], begun["recording"]) == (True, str(out / "press.mcap"))
        assert "stop it first" in running.answer("start_recording other")["answer"]
        published = running.shared.published
        wait_until(lambda: running.shared.published > published + 20)
        assert running.answer("stop_recording")["recording"] is None
        assert "without a folder" in running.answer("start_recording ../elsewhere")["answer"]
        assert "printable" in running.answer("start_recording a\0b")["answer"]
        assert "got 'dance'" in running.answer("dance")["answer"]
        running.command("start_recording unfinished")
        wait_until(lambda: (out / "unfinished.mcap").exists())
    with Recording(out / "press.mcap") as recording:
        assert sum(1 for _ in recording.frames()) >= 20
    with Recording(out / "unfinished.mcap") as recording:  # finished when the command ended
        assert recording.metadata.sensor == RECORDED.id


STALLING_SUBSCRIBER = """
import sys, time
from ninedtact.interop.dds import DdsParticipant
from ninedtact.interop.ros2_topics_and_messages import LIVE_TOPICS, QosProfile
with DdsParticipant(int(sys.argv[1]), "lo") as participant:
    readers = [participant.reader(f"/small/{name}", LIVE_TOPICS[name][0], QosProfile.RELIABLE) for name in LIVE_TOPICS]
    while not all([reader.take() for reader in readers[:1]]):
        time.sleep(0.01)
    print("receiving", flush=True)
    time.sleep(600)
"""


def test_a_subscriber_that_stalls_does_not_stop_the_sensor(tmp_path: Path) -> None:
    folder = load_sensor(sensor_folder(tmp_path / "small"))
    with (
        sensor_on_ros2(folder, tmp_path) as running,
        subprocess.Popen([sys.executable, "-c", STALLING_SUBSCRIBER, str(DOMAIN)], stdout=subprocess.PIPE) as stalling,
    ):
        assert stalling.stdout is not None
        assert stalling.stdout.readline() == b"receiving\n"
        stalling.send_signal(signal.SIGSTOP)
        try:
            before, read_before, began = running.shared.published, running.shared.sensor.frames_read, time.monotonic()
            wait_until(lambda: running.shared.sensor.frames_read > read_before + 300)
            took_s = time.monotonic() - began
            assert took_s < 12, "the sensor reads at its own rate"
            assert running.shared.published > before + 20
        finally:
            stalling.send_signal(signal.SIGCONT)
            stalling.kill()


def test_the_command_publishes_two_sensors_under_their_names(tmp_path: Path) -> None:
    folder, images = sensor_folder(tmp_path / "small"), image_folder(tmp_path / "images", *[100] * 15)
    named = [f"left={images}", f"right={images}", "--sensor", f"left={folder}", f"right={folder}"]
    words = ["--source", *named, "--loop", "--force", "none", "--interface", INTERFACE, "--domain", str(DOMAIN)]
    start = [sys.executable, "-m", "ninedtact", "ros2", *words]
    with DdsParticipant(DOMAIN, INTERFACE) as participant, subprocess.Popen(start, cwd=tmp_path) as running:
        try:
            for name in ("left", "right"):
                reader = participant.reader(f"/{name}/image_raw", LIVE_TOPICS[Topic.IMAGES][0], QosProfile.RELIABLE)
                wait_until(lambda reader=reader: bool(reader.take()))  # type: ignore[misc]
        finally:
            running.send_signal(signal.SIGINT)
        assert running.wait(60) == 0

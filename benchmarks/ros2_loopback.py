"""ROS 2 on loopback: a 640 x 480 image, 20,000 points and a wrench at 60 Hz to another process, by Cyclone DDS.

Prints messages received, latency from the stamp of the image to the subscriber, which has then decoded the message, and the share
of one core that encoding (quantities to CDR, points and normals included) and writing (DDS) take.
"""

import multiprocessing
import time
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import tyro
from figures import Figure, answer

from ninedtact import calibrate, default_twin
from ninedtact.calibration.procedure import CalibrationImages
from ninedtact.calibration.sensor_folder import SensorFolder
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.interop.dds import DdsParticipant
from ninedtact.interop.ros2_topics_and_messages import LIVE_TOPICS, POINTS, QosProfile, SensorMessages
from ninedtact.quantities import Frame, HeightMap, Rectified, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_minus_monotonic_ns
from ninedtact.recording.topics_and_messages import Topic, type_store
from ninedtact.shape.surface import point_cloud
from ninedtact.simulation.calibration_images import simulate_calibration_images

HZ, DOMAIN, INTERFACE, SENSOR = 60.0, 77, "lo", "bench"
TOPICS = (Topic.IMAGES, POINTS, Topic.ESTIMATED)
GRID, EVERY = (360, 500), 3  # 120 x 167 points
DISCOVERY_S, LINGER_S = 2.0, 1.0


def ros2_loopback(seconds: float = 30.0, quick: bool = False, json: bool = False) -> None:
    """Send with both profiles of quality of service, and print the figures."""
    images = CalibrationImages(**vars(simulate_calibration_images(default_twin())))
    made = calibrate(images, settings=CalibrationSettings(method="ratio"))
    messages = SensorMessages(SensorFolder(Path(), made.record), SENSOR, EVERY)
    profiles = (QosProfile.RELIABLE,) if quick else (QosProfile.RELIABLE, QosProfile.SENSOR_DATA)
    figures = [figure for profile in profiles for figure in publish(messages, profile, 1.0 if quick else seconds)]
    answer(f"ROS 2 on loopback at {HZ:g} Hz", figures, json)


def reading(number: int) -> Reading:
    """Return a reading of noise, different for each number."""
    noise, now_ns = np.random.default_rng(number), time.monotonic_ns()
    image = noise.integers(0, 255, (480, 640, 3), np.uint8)
    z_mm = noise.normal(0, 0.05, GRID).astype(np.float32)
    height = HeightMap(z_mm, np.full(GRID, 2, np.uint8), 0.05, camera_distance_mm=14.0, stamp_ns=now_ns)
    estimate = WrenchEstimate(Wrench(noise.normal(size=3), noise.normal(size=3)), np.eye(6), True)
    return Reading(Frame(image, now_ns, number), (grey := Rectified(z_mm, 0.05)), height, grey, force=estimate)


def publish(messages: SensorMessages, profile: QosProfile, seconds: float) -> list[Figure]:
    """Publish readings to a listener in another process; return what it received and what sending cost."""
    readings, context = [reading(number) for number in range(8)], multiprocessing.get_context("spawn")
    here, there = context.Pipe()
    with DdsParticipant(DOMAIN, INTERFACE) as participant:
        writers = {topic: participant.writer(messages.path(topic), LIVE_TOPICS[topic][0], profile) for topic in TOPICS}
        listener = context.Process(target=listen, args=(profile, seconds + DISCOVERY_S, there))
        listener.start()
        while not all(writer.has_subscribers for writer in writers.values()):
            time.sleep(0.05)
        time.sleep(DISCOVERY_S)
        encode_s = write_s = 0.0
        began, cpu_s, count = time.monotonic(), time.process_time(), round(seconds * HZ)
        for number in range(count):
            time.sleep(max(0.0, began + number / HZ - time.monotonic()))
            wall_ns, start_s = time.monotonic_ns() + wall_minus_monotonic_ns(), time.thread_time()
            encoded = messages.encode(readings[number % 8], wall_ns, TOPICS)
            encoded_s = time.thread_time()
            for topic, cdr in encoded.items():
                writers[topic].write(cdr)
            encode_s, write_s = encode_s + encoded_s - start_s, write_s + time.thread_time() - encoded_s
        took_s, cpu_s = time.monotonic() - began, time.process_time() - cpu_s
        dropped = sum(writer.dropped for writer in writers.values())
        latency_ms = here.recv()
        listener.join()
    start_s = time.thread_time()
    for each in readings:
        point_cloud(each.height, EVERY)
    points_s = (time.thread_time() - start_s) / len(readings) * count
    shares = {"encoding": encode_s, "of it points and normals": points_s, "writing": write_s, "whole process": cpu_s}
    return [
        Figure(f"{profile}: readings sent, per second", f"{count}, {count / took_s:.1f}"),
        Figure(f"{profile}: messages refused by a stalled subscriber", dropped),
        *(Figure(f"{profile}: {name}, % of a core", 100 * each_s / took_s) for name, each_s in shares.items()),
        *(Figure(f"{profile}: {topic}: received", received(values)) for topic, values in latency_ms.items()),
    ]


def received(latency_ms: list[float]) -> str:
    """Return how many messages were received, and after what time, in words."""
    middle, tail, worst = np.percentile(latency_ms, (50, 95, 100)) if latency_ms else (np.nan,) * 3
    return f"{len(latency_ms)}; latency median {middle:.2f}, 95 % {tail:.2f}, most {worst:.2f} ms"


def listen(profile: QosProfile, seconds: float, pipe: Connection) -> None:
    """Receive for a time in another process, and send the latencies of each topic."""
    latency_ms: dict[str, list[float]] = {topic: [] for topic in TOPICS}
    with DdsParticipant(DOMAIN, INTERFACE) as participant:
        readers = {topic: participant.reader(f"/{SENSOR}/{topic}", LIVE_TOPICS[topic][0], profile) for topic in TOPICS}
        end_at = time.monotonic() + seconds + LINGER_S
        while time.monotonic() < end_at:
            for topic, reader in readers.items():
                for cdr in reader.take():
                    stamp = type_store().deserialize_cdr(cdr, LIVE_TOPICS[topic][0]).header.stamp
                    latency_ms[topic].append((time.time_ns() - stamp.sec * 10**9 - stamp.nanosec) / 1e6)
            time.sleep(0.0005)
    pipe.send(latency_ms)


if __name__ == "__main__":
    tyro.cli(ros2_loopback)

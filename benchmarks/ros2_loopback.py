"""ROS 2 on loopback: a 640 x 480 image, 20,000 points and a wrench at 60 Hz to another process, by Cyclone DDS.

Prints messages received, latency from the stamp of the image to the subscriber, which has then decoded the message, and the share
of one core that encoding (quantities to CDR, points and normals included) and writing (DDS) take.
"""

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from ninedtact.calibration.procedure import CalibrationImages, calibrate
from ninedtact.calibration.save import save_sensor
from ninedtact.calibration.settings import CalibrationSettings
from ninedtact.interop.dds import DdsParticipant
from ninedtact.interop.ros2_topics_and_messages import LIVE_TOPICS, POINTS, QosProfile, SensorMessages
from ninedtact.quantities import Frame, HeightMap, Rectified, Wrench, WrenchEstimate
from ninedtact.reading import Reading
from ninedtact.recording.metadata import wall_minus_monotonic_ns
from ninedtact.recording.topics_and_messages import Topic, type_store
from ninedtact.shape.surface import point_cloud
from ninedtact.simulation.calibration_images import simulate_calibration_images
from ninedtact.simulation.twin import default_twin

HZ, DOMAIN, INTERFACE, SENSOR = 60.0, 77, "lo", "bench"
TOPICS = (Topic.IMAGES, POINTS, Topic.ESTIMATED)
GRID, EVERY = (360, 500), 3  # 120 x 167 points
DISCOVERY_S, LINGER_S = 2.0, 1.0


def reading(number: int) -> Reading:
    """A reading of noise, different for each number."""
    noise = np.random.default_rng(number % 8)
    now_ns = time.monotonic_ns()
    image = noise.integers(0, 255, (480, 640, 3), np.uint8)
    z_mm = noise.normal(0, 0.05, GRID).astype(np.float32)
    height = HeightMap(z_mm, np.full(GRID, 2, np.uint8), 0.05, camera_distance_mm=14.0, stamp_ns=now_ns)
    estimate = WrenchEstimate(Wrench(noise.normal(size=3), noise.normal(size=3)), np.eye(6), True)
    return Reading(Frame(image, now_ns, number), (grey := Rectified(z_mm, 0.05)), height, grey, force=estimate)


def publish(profile: QosProfile, seconds: float, folder: Path) -> None:
    images = CalibrationImages(**vars(simulate_calibration_images(default_twin())))
    sensor = save_sensor(folder / "sensor", calibrate(images, settings=CalibrationSettings(method="ratio")))
    messages = SensorMessages(sensor, SENSOR, EVERY)
    readings = [reading(number) for number in range(8)]
    with DdsParticipant(DOMAIN, INTERFACE) as participant:
        writers = {topic: participant.writer(messages.path(topic), LIVE_TOPICS[topic][0], profile) for topic in TOPICS}
        listener = subprocess.Popen(
            [sys.executable, __file__, "--listen", str(seconds + DISCOVERY_S), "--qos", profile]
        )
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
        start_s = time.thread_time()
        for each in readings:
            point_cloud(each.height, EVERY)
        points_share = (time.thread_time() - start_s) / len(readings) * count / took_s
        print(
            f"{profile}: {count} readings in {took_s:.1f} s ({count / took_s:.1f} Hz), "
            f"{sum(writer.dropped for writer in writers.values())} messages refused by a stalled subscriber\n"
            f"  one core: encoding {100 * encode_s / took_s:.1f} % (points and normals {100 * points_share:.1f} %), "
            f"writing {100 * write_s / took_s:.1f} %, "
            f"whole process {100 * cpu_s / took_s:.1f} %",
            flush=True,
        )
        listener.wait()
        print(f"  sent {count} of each", flush=True)


def listen(profile: QosProfile, seconds: float) -> None:
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
    for topic, values in latency_ms.items():
        middle, tail, worst = np.percentile(values, (50, 95, 100)) if values else (np.nan,) * 3
        print(
            f"  {topic:17s} received {len(values):5d}   latency median {middle:5.2f}, 95 % {tail:5.2f}, most {worst:6.2f} ms"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--listen", type=float, default=None, help="be the other process")
    parser.add_argument("--qos", type=QosProfile, default=None)
    options = parser.parse_args()
    if options.listen is not None:
        listen(options.qos, options.listen)
        return
    for profile in [options.qos] if options.qos else [QosProfile.RELIABLE, QosProfile.SENSOR_DATA]:
        with tempfile.TemporaryDirectory() as folder:
            publish(profile, options.seconds, Path(folder))


if __name__ == "__main__":
    main()

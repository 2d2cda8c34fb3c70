"""A thin ROS 2 node of a sensor, with services and parameters, for computers that have ROS (rclpy). Untried: there was no ROS here.

It publishes the messages of `ninedtact ros2` under the same names and offers the service `~/take_reference`
(std_srvs/Trigger). Without ROS, use `ninedtact ros2`.
"""

import sys
import time

import ninedtact
from ninedtact.interop.ros2_topics_and_messages import LIVE_TOPICS, STATUS, TF_STATIC, QosProfile, SensorMessages
from ninedtact.recording.metadata import wall_minus_monotonic_ns
from ninedtact.recording.topics_and_messages import Topic

try:
    import rclpy
    from rclpy.node import Node
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
    from rosidl_runtime_py.utilities import get_message
    from std_srvs.srv import Trigger
except ImportError as missing:
    sys.exit(
        f"expected ROS 2 with rclpy, got: {missing}; source its setup file, or run 'ninedtact ros2', which needs no ROS"
    )


def ros_qos(profile: QosProfile) -> QoSProfile:
    """Return a quality of service in the words of rclpy."""
    best_effort, latched = profile is QosProfile.SENSOR_DATA, profile is QosProfile.LATCHED
    return QoSProfile(
        depth=1 if latched else 5,
        reliability=ReliabilityPolicy.BEST_EFFORT if best_effort else ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


class SensorNode(Node):
    """Publishes a sensor; parameters: sensor, source, force, name, points_every."""

    def __init__(self) -> None:
        super().__init__("ninedtact")
        defaults = {"sensor": "", "source": "sim", "force": "physics", "name": "", "points_every": 3}
        self.values = {key: self.declare_parameter(key, value).value for key, value in defaults.items()}
        folder = ninedtact.load_sensor(self.values["sensor"])
        self.messages = SensorMessages(folder, self.values["name"] or folder.id, self.values["points_every"])
        self.sensor = ninedtact.open(folder, self.values["source"], self.values["force"])
        self.wants_reference = False
        self.create_service(Trigger, "~/take_reference", self.on_take_reference)
        self.outlets = {
            topic: self.create_publisher(get_message(kind), self.messages.path(topic), ros_qos(profile))
            for topic, (kind, profile) in LIVE_TOPICS.items()
            if topic not in (STATUS, Topic.MEASURED)  # a force/torque sensor has a node of its own
        }
        self.static = self.create_publisher(
            get_message("tf2_msgs/msg/TFMessage"), TF_STATIC, ros_qos(QosProfile.LATCHED)
        )

    def on_take_reference(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        """Make the next images the reference; nothing may touch the gel."""
        self.wants_reference = response.success = True
        return response

    def run(self) -> None:
        """Publish until ROS shuts down. rclpy publishes bytes that are already in CDR as they are."""
        self.static.publish(self.messages.encode_static_transforms(time.time_ns()))
        shown = None
        with self.sensor:
            while rclpy.ok():
                rclpy.spin_once(self, timeout_sec=0.0)
                if self.wants_reference:
                    self.sensor.take_reference()
                    self.wants_reference = False
                reading = self.sensor.read()
                wanted = [topic for topic, outlet in self.outlets.items() if outlet.get_subscription_count()]
                wall_ns = reading.stamp_ns + wall_minus_monotonic_ns()
                if reading.reference is not shown:
                    shown = reading.reference
                    self.outlets["reference_grey"].publish(self.messages.encode_reference(shown, wall_ns))
                for topic, message in self.messages.encode(reading, wall_ns, wanted).items():
                    self.outlets[topic].publish(message)


if __name__ == "__main__":
    rclpy.init()
    SensorNode().run()

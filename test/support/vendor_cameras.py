"""Cameras and a lamp of a lab, as their drivers show them: ``python -m support.vendor_cameras URDF TRUTH``.

They see the lamp on the tip of the robot that ``/joint_states_of_vendor`` tells of, through lenses and from places that
``TRUTH`` says, a JSON file: ``tip``, ``light`` (name), ``offset`` [m], ``cameras`` by name, each with ``K``, ``R`` and
``t``. Images come five times a second, on the computer's clock. ``/testbed/set_light`` switches the lamp, ``/strobe``
darkens it for an image.
"""

import json
import sys
from pathlib import Path

import numpy as np
import pinocchio as pin
from rclpy.node import Node
from sensor_msgs.msg import Image, JointState
from std_msgs.msg import String
from std_srvs.srv import SetBool

from im_core.ros import qos, run
from im_core.ros.guard import GuardedNode
from im_msgs.srv import SetLight

WIDTH, HEIGHT, PERIOD_S = 640, 480, 0.2
GAIN, READ_NOISE, BLACK_DN, ROOM_DN, SPOT_DN, SIGMA_PX = 10.0, 28.0, 8.0, 20.0, 120.0, 1.3


class VendorCameras(GuardedNode):
    """Drivers of cameras and of a lamp."""

    def __init__(self, urdf: str, truth: dict) -> None:
        super().__init__("vendor_cameras")
        self.model = pin.buildModelFromUrdf(urdf)
        self.data, self.truth = self.model.createData(), truth
        self.q, self.random = None, np.random.default_rng(1)
        self.on, self.strobed = False, True
        self.u, self.v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
        self.lights = self.create_publisher(String, "/testbed/lights", qos.LATCHED)
        self.images = {
            name: self.create_publisher(Image, f"/{name}/image_raw", qos.SENSOR) for name in truth["cameras"]
        }
        self.create_subscription(JointState, "/joint_states_of_vendor", self.hear, 10)
        self.create_service(SetLight, "/testbed/set_light", self.switch)
        self.create_service(SetBool, "/strobe", self.strobe)
        self.tell()
        self.create_timer(PERIOD_S, self.expose)

    def tell(self) -> None:
        """Say whether the lamp is on."""
        self.lights.publish(String(data=json.dumps({self.truth["light"]: self.on})))

    def switch(self, request: SetLight.Request, response: SetLight.Response) -> SetLight.Response:
        """Switch the lamp."""
        self.on, response.success = request.on, True
        self.tell()
        return response

    def strobe(self, request: SetBool.Request, response: SetBool.Response) -> SetBool.Response:
        """Let the lamp shine, or not, while it is on."""
        self.strobed, response.success = request.data, True
        return response

    def hear(self, message: JointState) -> None:
        """Note where the joints are."""
        q = pin.neutral(self.model)
        for name, position in zip(message.name, message.position, strict=True):
            q[self.model.joints[self.model.getJointId(name)].idx_q] = position
        self.q = q

    def expose(self) -> None:
        """Send an image of each camera."""
        if self.q is None:
            return
        stamp = self.get_clock().now().to_msg()
        pin.framesForwardKinematics(self.model, self.data, self.q)
        lamp = self.data.oMf[self.model.getFrameId(self.truth["tip"])].act(np.array(self.truth["offset"]))
        for name, camera in self.truth["cameras"].items():
            x, y, z = np.array(camera["K"]) @ (np.array(camera["R"]) @ lamp + camera["t"])
            mean = np.full((HEIGHT, WIDTH), BLACK_DN + ROOM_DN)
            if self.on and self.strobed and z > 0.0:
                off = (self.u - x / z) ** 2 + (self.v - y / z) ** 2
                mean += SPOT_DN * np.exp(-off / (2.0 * SIGMA_PX**2))
            noise = np.sqrt(READ_NOISE**2 + GAIN * (mean - BLACK_DN)) / GAIN
            grey = np.clip(np.rint(mean + noise * self.random.normal(size=mean.shape)), 0, 255).astype(np.uint8)
            image = Image(height=HEIGHT, width=WIDTH, encoding="mono8", step=WIDTH)
            image.data, image.header.stamp = grey.tobytes(), stamp
            self.images[name].publish(image)


def make() -> Node:
    """The node of the command line."""
    return VendorCameras(sys.argv[1], json.loads(Path(sys.argv[2]).read_text()))


if __name__ == "__main__":
    sys.exit(run.main(make, []))

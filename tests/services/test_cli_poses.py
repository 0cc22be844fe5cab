"""What `huepose poses` prints of a pose, in the camera's frame and in the robot's."""

import pytest
from msgspec.structs import replace

from huepose_protos.examples import messages
from huepose_protos.messages import Mount, PoseMessage
from huepose_services.cli.poses import _line, _where_on_robot

HALF = 0.5**0.5
MOUNT = Mount(parent="base_link", translation=(1.0, 0.0, 0.5), quaternion=(0.0, 0.0, HALF, HALF))
"""A quarter turn about z, from x to y."""


@pytest.fixture(scope="module")
def pose():
    found = next(m for m in messages() if isinstance(m, PoseMessage) and m.state == "TRACKING")
    return replace(found, translation=(0.1, 0.2, 0.8), quaternion=(0.0, 0.0, 0.0, 1.0))


def test_a_pose_in_the_robots_frame(pose):
    where = _where_on_robot(pose, MOUNT)
    assert where == "+0.8000 +0.1000 +1.3000 m   +0.0000 +0.0000 +0.7071 +0.7071"
    assert where in _line(pose, where)

"""Your own ROS 2 topic, without ROS on this machine: the newest pose of one object, if it is TRACKING.

The worker `ros2` publishes all objects, with /tf and detections (docs/ros2.md). On the robot:

    ros2 run rmw_zenoh_cpp rmw_zenohd
    ros2 topic echo /pick/target

huepose up tea_box/pipeline.yaml
python examples/06_ros2.py tea_box [tcp/localhost:7447 [tcp/robot.local:7447]]
"""

import sys
from contextlib import suppress

from huepose_protos import PoseClient
from huepose_protos.local import pose_endpoints
from huepose_services.ros2.messages import POSE, cdr, pose_stamped
from huepose_services.ros2.publisher import Node
from huepose_services.ros2.work import open_ros_session
from huepose_services.runtime.config import Ros2Config

if len(sys.argv) < 2:
    sys.exit(__doc__)
name = sys.argv[1]
router = sys.argv[2] if len(sys.argv) > 2 else "tcp/localhost:7447"
try:
    with suppress(KeyboardInterrupt), PoseClient(sys.argv[3:] or pose_endpoints(), object=name) as client:
        node = Node(open_ros_session(Ros2Config(connect=router)), "pick_target", domain=0, style="rmw_zenoh")
        while client.next(0.0) is not None:
            pass  # It is old: the router may have been waited for.
        for pose in client:
            if pose.state == "TRACKING":
                node.publish("/pick/target", POSE, cdr(pose_stamped(pose)))
except ValueError as error:  # a wrong address, or several pipelines run here
    sys.exit(str(error))

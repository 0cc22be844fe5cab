"""A pick loop: act on a pose only if it is TRACKING and the object has come to rest.

huepose up tea_box/pipeline.yaml
python examples/03_pick_when_still.py tea_box [tcp/robot.local:7447]

The rendered scene of `huepose new` never comes to rest: there it prints this until Ctrl-C. With a camera it
ends.
"""

import sys
import time
from contextlib import suppress

import numpy as np

from huepose_protos import PoseClient
from huepose_protos.local import pose_endpoints

STILL_S, STILL_M = 0.5, 0.003  # at rest: moves less than this distance in this time; choose for your gripper
SAY_EVERY_S = 3.0


def wait_until_still(client: PoseClient, name: str) -> np.ndarray:
    """T_parent_obj if the camera's pose on the robot is given, else T_cam_obj. For a camera on a hand it
    waits until the camera pose is known for that moment. A moving camera whose pose is never given cannot be
    distinguished from a fixed one without a mount: then T_cam_obj is returned, too."""
    if client.camera(5.0) is None:
        sys.exit(f"no camera: {client.why_silent()}")
    began, start, say_at = 0.0, None, time.monotonic() + SAY_EVERY_S
    mounted = False  # the camera pose was given at least once
    instances: set[int] = set()
    while True:
        while (pose := client.next(0.0)) is not None:
            if pose.object == name:
                instances.add(pose.instance)
        # The poses predicted to now, None without a recent one; the first instance that is TRACKING counts.
        poses = (client.at(object=name, instance=instance) for instance in sorted(instances))
        now = next((one for one in poses if one is not None and one.state == "TRACKING"), None)
        sure = now is not None
        mounted = mounted or client.camera().mount is not None or (sure and now.T_parent_obj is not None)
        placed = sure and (now.T_parent_obj is not None or not mounted)
        if not sure or start is None or np.linalg.norm(now.T_cam_obj[:3, 3] - start) > STILL_M:
            began, start = time.monotonic(), now.T_cam_obj[:3, 3] if sure else None
        elif placed and time.monotonic() - began > STILL_S:
            return now.T_parent_obj if mounted else now.T_cam_obj
        if time.monotonic() > say_at:
            say_at += SAY_EVERY_S
            why = "it moves" if placed else "the camera pose is not known now"
            why = why if sure else "none of its poses is TRACKING"
            known = client.looked_for()  # None without an answer
            if known is not None and name not in known:
                why = f"{name} is not searched for; searched for: {', '.join(known) or 'nothing'}"
            print("waiting:", why, file=sys.stderr)
        time.sleep(0.02)


def pick(T: np.ndarray) -> None:
    print("your robot goes to", T[:3, 3].round(3), flush=True)


if len(sys.argv) < 2:
    sys.exit(__doc__)
try:
    with suppress(KeyboardInterrupt), PoseClient(sys.argv[2:] or pose_endpoints()) as client:
        pick(wait_until_still(client, sys.argv[1]))
except ValueError as error:  # a wrong address, or several pipelines run here
    sys.exit(str(error))

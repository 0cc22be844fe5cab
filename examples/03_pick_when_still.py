"""A pick loop: act on a pose only when it may be acted on and the object has come to rest.

huepose up tea_box/pipeline.yaml
python examples/03_pick_when_still.py tea_box [tcp/robot.local:7447]

The drawn scene of `huepose new` never rests: there it says so until Ctrl-C. With a camera it ends.
"""

import sys
import time
from contextlib import suppress

import numpy as np

from huepose_protos import PoseClient
from huepose_protos.local import pose_endpoints

STILL_S, STILL_M = 0.5, 0.003  # so long within so little: choose what your gripper forgives
SAY_EVERY_S = 3.0


def wait_until_still(client: PoseClient, name: str) -> np.ndarray:
    """T_parent_obj where somebody says where the camera is on the robot, else T_cam_obj. A camera on a hand
    is waited for until its place is known at that moment. A camera that moves, and of which nobody ever says
    where it is, looks the same from here as a fixed one that has no mount: then too it is T_cam_obj."""
    if client.camera(5.0) is None:
        sys.exit(f"no camera says where it is: {client.why_silent()}")
    began, start, say_at = 0.0, None, time.monotonic() + SAY_EVERY_S
    mounted = False  # where the camera is was said, if only once
    while True:
        now = client.at(object=name)  # where it is at this moment; None where nothing is known that is new
        sure = now is not None and now.state == "TRACKING"
        mounted = mounted or client.camera().mount is not None or (sure and now.T_parent_obj is not None)
        placed = sure and (now.T_parent_obj is not None or not mounted)
        if not sure or start is None or np.linalg.norm(now.T_cam_obj[:3, 3] - start) > STILL_M:
            began, start = time.monotonic(), now.T_cam_obj[:3, 3] if sure else None
        elif placed and time.monotonic() - began > STILL_S:
            return now.T_parent_obj if mounted else now.T_cam_obj
        if time.monotonic() > say_at:
            say_at += SAY_EVERY_S
            why = "it moves" if placed else "nobody says where the camera is now"
            why = why if sure else "no pose of it may be acted on"
            known = client.looked_for()  # None where nobody says
            if known is not None and name not in known:
                why = f"{name} is not looked for; what is: {', '.join(known) or 'nothing'}"
            print("waiting:", why, file=sys.stderr)
        time.sleep(0.02)


def pick(T: np.ndarray) -> None:
    print("your robot goes to", T[:3, 3].round(3), flush=True)


if len(sys.argv) < 2:
    sys.exit(__doc__)
with suppress(KeyboardInterrupt), PoseClient(sys.argv[2:] or pose_endpoints()) as client:
    pick(wait_until_still(client, sys.argv[1]))

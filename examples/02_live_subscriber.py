"""Print poses as they arrive, from a pipeline on this machine or behind a gateway.

huepose up tea_box/pipeline.yaml                              # in another terminal
python examples/02_live_subscriber.py [tcp/robot.local:7447]
"""

import os
import sys

from huepose_protos import PoseClient
from huepose_protos.local import pose_endpoints

try:
    with PoseClient(sys.argv[1:] or pose_endpoints()) as client:
        while True:
            pose = client.next(timeout_s=3.0)
            if pose is not None:
                fields = (pose.object, pose.instance, pose.state, f"{pose.quality:.2f}", pose.translation)
                print(*fields, flush=True)
            else:
                print(client.why_silent(), file=sys.stderr, flush=True)
except KeyboardInterrupt:
    pass
except ValueError as error:  # a wrong address, or several pipelines run here
    sys.exit(str(error))
except BrokenPipeError:  # `| head` has read enough, and nothing is left to flush at exit
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

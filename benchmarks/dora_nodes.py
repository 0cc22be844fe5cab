"""The two ends of the hop in dora-rs, started by `hops.py` with the Python of `make_env.sh dora`.

    dora_nodes.py send FRAMES BYTES RATE_HZ    puts frames on its output `frame`
    dora_nodes.py receive FILE.json            writes two times of every frame, in nanoseconds: until its
                                               pixels can be read in place, until they are copied

Needs dora-rs, pyarrow and numpy only.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
import pyarrow as pa
from dora import Node


def send(frames: int, size: int, rate_hz: float) -> None:
    """Every frame is stamped before dora copies it in."""
    node = Node()
    frame = np.random.default_rng(0).integers(0, 255, size, dtype=np.uint8)
    due = time.monotonic()
    for _ in range(frames):
        node.send_output("frame", pa.array(frame), {"sent_ns": time.monotonic_ns()})
        due += 1.0 / rate_hz
        time.sleep(max(0.0, due - time.monotonic()))


def receive(path: Path) -> None:
    """Until the sender has ended."""
    node, spans = Node(), []
    while (event := node.next(timeout=10.0)) is not None and event["type"] not in ("STOP", "ERROR"):
        if event["type"] != "INPUT":
            continue
        seen = event["value"].to_numpy(zero_copy_only=True)
        in_place_ns = time.monotonic_ns()
        seen.copy()
        copied_ns, sent_ns = time.monotonic_ns(), event["metadata"]["sent_ns"]
        spans.append((in_place_ns - sent_ns, copied_ns - sent_ns))
    path.write_text(json.dumps(spans))


if __name__ == "__main__":
    if sys.argv[1] == "send":
        send(int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4]))
    else:
        receive(Path(sys.argv[2]))

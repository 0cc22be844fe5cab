"""Frames under the usual limit of locked memory, 8 MiB, as an ordinary user: root would hide the failures."""

import json
import subprocess
import sys

import pytest

# Imports come before the change of user: an ordinary user may not be able to read this Python.
_PROLOGUE = """
import json, os, resource, sys, time
import encodings.idna
import msgspec, numpy as np, zenoh
from huepose_protos.buffers import pack
from huepose_protos.examples import messages
from huepose_protos.messages import FrameHeader
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.config import BusConfig, Config
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.session import lock_limit, open_worker_session

resource.setrlimit(resource.RLIMIT_MEMLOCK, (8 << 20, 8 << 20))
if os.getuid() == 0:
    os.setgroups([])
    os.setresgid(65534, 65534, 65534)
    os.setresuid(65534, 65534, 65534)
assert lock_limit() == 8 << 20
role = sys.argv[1]
config = Config(bus=BusConfig(base_port=int(sys.argv[2])))
session, warning = open_worker_session(config, role)
bus = Bus(session, config.keys, role, Log(role), Health(role))
"""
_CAMERA = (
    _PROLOGUE
    + """
first = int(sys.argv[3])
header = messages()[0]
specs, payload = pack({"color": np.zeros((480, 640, 3), np.uint8), "depth": np.zeros((480, 640), np.uint16)})
size = msgspec.structs.replace(header.intrinsics, width=640, height=480)
taken = session.declare_subscriber("t/taken", zenoh.handlers.FifoChannel(64))
publisher = session.declare_publisher(config.keys.frame)
while not getattr(publisher.matching_status, "matching", publisher.matching_status):
    time.sleep(0.02)
time.sleep(0.5)
for i in range(30):
    frame = msgspec.structs.replace(header, buffers=specs, intrinsics=size, frame_id=first + i)
    bus.put_pixels(config.keys.frame, frame, payload)
    # The reader's ring has one place: the next frame must not come before this one was taken or is lost.
    lost_at = time.monotonic() + 2.0
    while taken.try_recv() is None and time.monotonic() < lost_at:
        time.sleep(0.005)
    time.sleep(0.03)
print(json.dumps(warning), flush=True)
os._exit(9)  # as if killed: nothing is cleaned up
"""
)
_READER = (
    _PROLOGUE
    + """
ring = bus.inbox.ring(config.keys.frame)
print("there", flush=True)
got = []
while 129 not in got:
    bus.inbox.wait(0.1)
    taken = bus.take_with_payload(ring, FrameHeader)
    if taken is not None:
        got.append(taken[0].frame_id)
        session.put("t/taken", b"")
        time.sleep(0.01)
health = bus.health.message()
out = {"got": got, "locked_mib": health.locked_mib, **health.counters}
print(json.dumps(out), flush=True)
os._exit(0)
"""
)


@pytest.mark.live
def test_an_ordinary_user_loses_no_frame_also_after_a_restart_of_the_camera(base_port, monkeypatch):
    def start(code, *arguments):
        command = [sys.executable, "-c", code, *map(str, arguments)]
        return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)

    with start(_READER, "tracker", base_port) as reader:
        try:
            assert reader.stdout.readline() == "there\n"
            with start(_CAMERA, "camera", base_port, 0) as camera:
                assert json.loads(camera.communicate(timeout=30.0)[0]) is None
            monkeypatch.setenv("HUEPOSE_RESTARTS", "1")
            with start(_CAMERA, "camera", base_port, 100) as camera:
                warning = json.loads(camera.communicate(timeout=30.0)[0])
            assert "no room for another; frames go by the socket" in warning
            seen = json.loads(reader.communicate(timeout=30.0)[0])
        finally:
            reader.kill()
    # A frame on the socket may be dropped when this machine is blocked, as the first one, before the pool.
    assert sum(i < 100 for i in seen["got"]) >= 27
    assert sum(i >= 100 for i in seen["got"]) >= 27
    assert seen["frames_by_shared_memory"] >= 25
    # A pool of 6 MiB, 1280 KiB more, and a little for each link.
    assert 7.2 < seen["locked_mib"] < 7.4

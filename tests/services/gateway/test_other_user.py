"""Another user of the same machine can neither read messages of the workers nor send them any."""

import os
import socket
import subprocess
import sys
import time

import pytest

from huepose_protos import PoseClient
from huepose_protos.local import run_folder
from huepose_protos.messages import CorrectionMessage

pytestmark = [
    pytest.mark.live,
    pytest.mark.skipif(os.getuid() != 0, reason="only root can become another user"),
]

# Imports come before the change of user: another user may not be able to read this Python.
_STRANGER = """
import encodings.idna, json, os, sys, threading, time
import zenoh
from huepose_protos import encode
from huepose_protos.examples import messages
from huepose_protos.local import endpoint
from huepose_services.runtime.session import zenoh_config

folder, ports = sys.argv[1], [int(port) for port in sys.argv[2:]]
examples = {type(m).__name__: encode(m) for m in messages()}
os.setgroups([])
os.setresgid(65534, 65534, 65534)
os.setresuid(65534, 65534, 65534)
# As the workers were reached before, and as they are now.
ends = [f"tcp/127.0.0.1:{port}" for port in ports] + [endpoint(port, folder) for port in ports]
session = zenoh.open(zenoh_config([], ends))
heard = []
session.declare_subscriber("huepose/**", heard.append, allowed_origin=zenoh.Locality.REMOTE)
print("there", flush=True)
deadline = time.monotonic() + 3.0
while time.monotonic() < deadline:
    session.put("huepose/local/cam0/pose/no_such_object/0", examples["PoseMessage"])
    session.put("huepose/local/cam0/correction", examples["CorrectionMessage"])
    time.sleep(0.02)
answers = len(list(session.get("huepose/*/*/control", payload=examples["ControlRequest"], timeout=0.5)))
links = len(session.info.peers_zid())
print(json.dumps({"links": links, "heard": len(heard), "answers": answers}), flush=True)
os._exit(0)
"""


def test_a_stranger_hears_nothing_and_what_he_says_reaches_nobody(start):
    one = start()
    ports = [one.config.port(worker) for worker in ("tracker", "gateway")]
    command = [sys.executable, "-c", _STRANGER, str(run_folder()), *map(str, ports)]
    with (
        PoseClient(f"tcp/127.0.0.1:{one.port}") as reader,
        subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as stranger,
    ):
        assert stranger.stdout.readline() == "there\n"
        one.say_until(lambda: reader.latest() is not None)
        for number in range(200):
            one.say(number)
            time.sleep(0.01)
        said = stranger.communicate(timeout=20.0)[0]
        assert said == '{"links": 0, "heard": 0, "answers": 0}\n'
        assert reader.latest("no_such_object") is None
    assert one.tracker.take(one.corrections, CorrectionMessage) is None


def test_the_folder_and_its_sockets_are_closed_to_others(start):
    one = start()
    assert run_folder().stat().st_mode & 0o777 == 0o700
    probe = (
        "import os, socket, sys\n"
        "os.setresuid(65534, 65534, 65534)\n"
        "try:\n    socket.socket(socket.AF_UNIX).connect(sys.argv[1])\n"
        "except PermissionError:\n    print('closed')\n"
    )
    path = str(run_folder() / str(one.config.port("tracker")))
    done = subprocess.run([sys.executable, "-c", probe, path], capture_output=True, text=True, check=True)
    assert done.stdout == "closed\n"
    with socket.socket(socket.AF_UNIX) as mine:
        mine.connect(path)


def test_another_users_folder_is_not_used(tmp_path, monkeypatch):
    from huepose.support.errors import InputError
    from huepose_services.runtime.run_folder import make_folder

    theirs = tmp_path / "huepose"
    theirs.mkdir(mode=0o777)
    os.chown(theirs, 65534, 65534)
    monkeypatch.setenv("HUEPOSE_RUN", str(theirs))
    with pytest.raises(InputError, match="another user's, or a link"):
        make_folder()
    (tmp_path / "link").symlink_to(run_folder())
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / "link"))
    with pytest.raises(InputError, match="another user's, or a link"):
        make_folder()
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path / ("long" * 30)))
    with pytest.raises(InputError, match="too long for sockets"):
        make_folder()

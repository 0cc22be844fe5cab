"""Which endpoints a client accepts, and what it reports if nothing arrives from there."""

import json
import os
import socket
import subprocess
import sys
import time

import pytest

from huepose_protos import PoseClient
from huepose_protos.client import open_session
from huepose_protos.local import endpoint, pose_endpoints
from huepose_protos.reach import endpoint_of


@pytest.mark.parametrize(
    ("given", "tls", "expected"),
    [
        ("localhost", False, "tcp/localhost:7447"),
        ("localhost", True, "tls/localhost:7447"),
        ("robot.local:7000", False, "tcp/robot.local:7000"),
        ("tcp/10.0.0.7", True, "tcp/10.0.0.7:7447"),
        ("tls/robot.local:7000", False, "tls/robot.local:7000"),
        ("[::1]:7000", False, "tcp/[::1]:7000"),
        ("unixsock-stream//run/huepose/17448", False, "unixsock-stream//run/huepose/17448"),
    ],
)
def test_a_client_accepts_the_same_hosts_as_the_command_line(given, tls, expected):
    assert endpoint_of(given, tls) == expected


@pytest.mark.parametrize(
    "given", ["", "a b", "localhost:port", "localhost:99999", "tcp/", "robot/local", "::1"]
)
def test_an_invalid_endpoint_is_refused_in_one_line(given):
    with pytest.raises(ValueError, match=r"HOST|cannot be used") as refusal:
        PoseClient(given)
    assert "\n" not in str(refusal.value)
    assert ".cargo" not in str(refusal.value)


def test_a_client_needs_an_endpoint():
    with pytest.raises(ValueError, match=r"no endpoints; give a gateway's HOST, or local\.pose_endpoints"):
        PoseClient([])


def test_a_host_without_a_gateway_is_reported():
    with PoseClient("127.0.0.1:1") as client:
        said = "waiting for a gateway at tcp/127.0.0.1:1: no program listens there"
        assert client.why_silent() == said


@pytest.mark.parametrize("host", ["robot..local", "x" * 64])
def test_a_name_that_no_computer_has_is_reported(host):
    with PoseClient(host) as client:
        assert client.why_silent().endswith("no computer of this name is known")


def test_a_silent_peer_does_not_delay_closing():
    with socket.create_server(("127.0.0.1", 0)) as mute:
        session = open_session([f"127.0.0.1:{mute.getsockname()[1]}"])
        mute.settimeout(5.0)
        with mute.accept()[0]:
            began = time.monotonic()
            session.close()
            assert time.monotonic() - began < 4.0


def test_invalid_certificate_files_are_reported(tmp_path):
    for name in ("authority", "certificate", "key"):
        (tmp_path / name).write_text("nothing")
    files = {name: tmp_path / name for name in ("authority", "certificate", "key")}
    with PoseClient("127.0.0.1:1", **files) as client:
        assert "authority, certificate and key cannot be used" in client.why_silent()


def test_a_pipeline_that_is_being_started_is_distinguished_from_none(tmp_path):
    with PoseClient(pose_endpoints(folder=tmp_path)) as client:
        none = f"waiting for a pipeline: none runs at {tmp_path}/17447; `huepose up` starts one"
        assert client.why_silent() == none
        note = {"site": "lab", "camera": "left", "file": "/etc/lab.yaml"}
        (tmp_path / f"{2**22 + 1}-17447.json").write_text(json.dumps(note))  # of a process that is gone
        assert client.why_silent() == none
        (tmp_path / f"{os.getpid()}-17447.json").write_text(json.dumps(note))
        started = "waiting for a pipeline: lab/left, from /etc/lab.yaml, is being started or stopped"
        assert client.why_silent() == f"{started}; its log says how far it is"


def test_on_the_second_computer_the_client_refers_to_the_cameras_computer(tmp_path):
    note = {"site": "lab", "camera": "left", "file": "/etc/lab.yaml", "workers": ["estimator", "downlink"]}
    path = tmp_path / f"{os.getpid()}-17447.json"
    with PoseClient(pose_endpoints(17447, folder=tmp_path)) as client:
        path.write_text(json.dumps(note))
        alone = "here lab/left has perception only: ask the camera's computer for poses and objects"
        assert client.why_silent() == f"waiting for a pipeline: {alone}"
        path.write_text(json.dumps(note | {"far": ["estimator", "downlink"]}))  # on the camera's computer
        assert "is being started or stopped" in client.why_silent()


def test_a_single_given_endpoint_is_named_itself(tmp_path):
    with PoseClient([endpoint(17448, tmp_path)]) as client:
        assert f"none runs at {tmp_path}/17448;" in client.why_silent()


@pytest.mark.parametrize(
    "end",
    ["", "sys.exit(0)", "1 / 0", "client.close()"],
    ids=["at its end", "by exit", "by an error", "after it was closed"],
)
@pytest.mark.parametrize(
    "client", ["PoseClient('127.0.0.1:1')", "client.Reader(['tcp/127.0.0.1:1'], 'huepose/**')"]
)
def test_a_program_that_leaves_its_client_open_ends(client, end):
    program = f"import sys\nfrom huepose_protos import PoseClient, client\nclient = {client}\n{end}\n"
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert ended.returncode == ("1 / 0" in end)
    assert ended.stderr.count("Traceback") == ("1 / 0" in end)


def test_ctrl_c_ends_a_program_whose_client_subscribes():
    program = """
from huepose_protos import PoseClient
from huepose_protos.client import Client

def interrupted(*what):
    add(*what)
    raise KeyboardInterrupt

add, Client._listen = Client._listen, interrupted
try:
    with PoseClient("127.0.0.1:1"):
        print("went on")
except KeyboardInterrupt:
    print("ended")
"""
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=30)
    assert (ended.stdout, ended.stderr, ended.returncode) == ("ended\n", "", 0)

"""Where a client is told to read, and what it says where nothing comes from there."""

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
    ("given", "tls", "meant"),
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
def test_a_client_takes_what_the_command_line_takes(given, tls, meant):
    assert endpoint_of(given, tls) == meant


@pytest.mark.parametrize(
    "given", ["", "a b", "localhost:port", "localhost:99999", "tcp/", "robot/local", "::1"]
)
def test_what_is_no_place_is_refused_in_a_sentence(given):
    with pytest.raises(ValueError, match=r"HOST|cannot be used") as refusal:
        PoseClient(given)
    assert "\n" not in str(refusal.value)
    assert ".cargo" not in str(refusal.value)


def test_a_client_needs_a_place():
    with pytest.raises(ValueError, match=r"no endpoints; give a gateway's HOST, or local\.pose_endpoints"):
        PoseClient([])


def test_nobody_at_a_host_is_said():
    with PoseClient("127.0.0.1:1") as client:
        said = "waiting for a gateway at tcp/127.0.0.1:1: no program listens there"
        assert client.why_silent() == said


def test_one_that_takes_links_and_says_nothing_holds_up_no_end():
    with socket.create_server(("127.0.0.1", 0)) as mute:
        session = open_session([f"127.0.0.1:{mute.getsockname()[1]}"])
        mute.settimeout(5.0)
        with mute.accept()[0]:
            began = time.monotonic()
            session.close()
            assert time.monotonic() - began < 4.0


def test_files_that_are_no_certificates_are_said(tmp_path):
    for name in ("authority", "certificate", "key"):
        (tmp_path / name).write_text("nothing")
    files = {name: tmp_path / name for name in ("authority", "certificate", "key")}
    with PoseClient("127.0.0.1:1", **files) as client:
        assert "authority, certificate and key cannot be used" in client.why_silent()


def test_a_pipeline_that_is_being_started_is_told_from_none(tmp_path):
    with PoseClient(pose_endpoints(folder=tmp_path)) as client:
        none = f"waiting for a pipeline: none runs at {tmp_path}/17447; `huepose up` starts one"
        assert client.why_silent() == none
        note = {"site": "lab", "camera": "left", "file": "/etc/lab.yaml"}
        (tmp_path / f"{2**22 + 1}-17447.json").write_text(json.dumps(note))  # of a process that is gone
        assert client.why_silent() == none
        (tmp_path / f"{os.getpid()}-17447.json").write_text(json.dumps(note))
        started = "waiting for a pipeline: lab/left, from /etc/lab.yaml, is being started or stopped"
        assert client.why_silent() == f"{started}; its log says how far it is"


def test_at_the_second_computer_the_camera_s_is_named(tmp_path):
    note = {"site": "lab", "camera": "left", "file": "/etc/lab.yaml", "workers": ["estimator", "downlink"]}
    path = tmp_path / f"{os.getpid()}-17447.json"
    with PoseClient(pose_endpoints(17447, folder=tmp_path)) as client:
        path.write_text(json.dumps(note))
        alone = "here lab/left has perception only: ask the camera's computer for poses and objects"
        assert client.why_silent() == f"waiting for a pipeline: {alone}"
        path.write_text(json.dumps(note | {"far": ["estimator", "downlink"]}))  # as the camera's says it
        assert "is being started or stopped" in client.why_silent()


def test_a_place_that_nobody_took_for_a_pipelines_second_port_is_named_itself(tmp_path):
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
def test_a_program_ends_that_leaves_its_client_open(client, end):
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

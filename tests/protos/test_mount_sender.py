"""The camera poses that a robot's program sends: a rigid transform, with a timestamp of the right clock."""

import json
import os
import queue
import time

import numpy as np
import pytest
import zenoh

from huepose_protos import decode
from huepose_protos.client import peer
from huepose_protos.local import endpoint
from huepose_protos.messages import MountMessage
from huepose_protos.mount_sender import MountSender

ROTATED = np.array([[0.0, -1.0, 0.0, 0.1], [1.0, 0.0, 0.0, 0.2], [0.0, 0.0, 1.0, 0.3], [0.0, 0.0, 0.0, 1.0]])


@pytest.fixture
def sender(monkeypatch, tmp_path):
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    with MountSender("base_link") as sender:
        yield sender


@pytest.mark.parametrize(
    ("T", "found"),
    [
        (2.0 * np.eye(4), "last row"),
        (np.diag([2.0, 2.0, 2.0, 1.0]), "scaled or sheared"),
        (np.diag([1.0, 1.0, 0.99, 1.0]), "scaled or sheared"),
        (np.eye(4) + 0.1 * np.eye(4, k=1), "scaled or sheared"),
        (np.diag([1.0, 1.0, -1.0, 1.0]), "mirrored"),
        (np.zeros((4, 4)), "last row"),
        (ROTATED.T, "last row"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.eye(3), r"shape \(3, 3\)"),
        (None, r"shape \(\)"),
    ],
)
def test_a_matrix_that_is_no_rigid_transform_is_refused_with_the_reason(sender, T, found):
    with pytest.raises(ValueError, match=f"no rigid motion: found .*{found}.*; expected a"):
        sender.tell(T)


def test_a_timestamp_of_another_clock_is_refused_and_the_right_clock_named(sender):
    now = time.monotonic_ns()
    for stamp_ns in (time.time_ns(), now + 2 * 10**9, now - 60 * 10**9):
        with pytest.raises(ValueError, match=r"s from now: give the time\.monotonic_ns\(\)"):
            sender.tell(ROTATED, stamp_ns)


def test_a_matrix_that_is_rigid_to_a_thousandth_is_sent(sender):
    sent = queue.SimpleQueue()
    sender._session.declare_subscriber("huepose/local/cam0/mount", sent.put)
    nearly = ROTATED.astype(np.float32) * [[1.0001], [1.0], [1.0], [1.0]]
    sender.tell(nearly, time.monotonic_ns() - 20_000_000)
    mount = decode(sent.get(timeout=10.0).payload.to_bytes(), MountMessage).mount
    assert mount.quaternion == pytest.approx((0.0, 0.0, 0.5**0.5, 0.5**0.5), abs=1e-4)


@pytest.mark.parametrize("kind", [np.int64, float])
def test_a_timestamp_of_numpy_or_of_a_float_is_sent_as_an_integer(sender, kind):
    sent = queue.SimpleQueue()
    sender._session.declare_subscriber("huepose/local/cam0/mount", sent.put)
    stamp_ns = kind(time.monotonic_ns())
    sender.tell(ROTATED, stamp_ns)
    assert decode(sent.get(timeout=10.0).payload.to_bytes(), MountMessage).capture_ns == stamp_ns


def test_the_sender_finds_a_second_cameras_pipeline_that_starts_later(monkeypatch, tmp_path):
    """That pipeline does not listen at the sockets of the first camera."""
    monkeypatch.setenv("HUEPOSE_RUN", str(tmp_path))
    monkeypatch.setattr("huepose_protos.local._LOOK_EVERY_NS", 0)
    sent = queue.SimpleQueue()
    with MountSender("base_link", camera="right") as sender, zenoh.open(listening_at(17467)) as camera:
        camera.declare_subscriber("huepose/local/right/mount", sent.put)
        note = {"base_port": 17467, "site": "local", "camera": "right", "file": "pipeline.yaml"}
        (tmp_path / f"{os.getpid()}-17467.json").write_text(json.dumps(note))
        for _ in range(600):
            sender.tell(np.eye(4))
            time.sleep(0.05)
            if not sent.empty():
                break
        assert decode(sent.get_nowait().payload.to_bytes(), MountMessage).mount.parent == "base_link"


def listening_at(port):
    return peer([], listen=[endpoint(port)])

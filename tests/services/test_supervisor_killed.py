"""After SIGKILL of `huepose up` no worker is left, and it can be started again at once."""

import json
import os
import signal
import time

import pytest

from huepose_protos.client import open_session
from tests.services.conftest import runs, started_by

pytestmark = [pytest.mark.live, pytest.mark.timeout(240)]


@pytest.fixture
def with_gateway(pipeline, base_port):
    """A pipeline of a camera that never ends and a gateway, and the gateway's address."""
    path, listen = pipeline(once=False, rate=30), f"127.0.0.1:{base_port + 9}"
    more = {"workers": ["camera", "gateway"], "gateway": {"listen": listen}}
    path.write_text(json.dumps(json.loads(path.read_text()) | more))
    return path, listen


def _until_it_answers(listen, wait_until):
    with open_session([f"tcp/{listen}"]) as session:
        wait_until(lambda: any(r.ok for r in session.get("huepose/*/*/remote/camera", timeout=0.5)), 60.0)


@pytest.mark.parametrize("stopped", [False, True])
def test_all_workers_end_with_their_supervisor_and_it_starts_again(
    with_gateway, huepose, wait_until, stopped
):
    path, listen = with_gateway
    first = huepose("up", path)
    _until_it_answers(listen, wait_until)
    workers = started_by(first.pid)
    assert len(workers) == 2
    if stopped:  # a worker that hangs also ends
        os.kill(workers[1], signal.SIGSTOP)
    first.kill()
    started = time.monotonic()
    wait_until(lambda: not any(map(runs, workers)), 10.0)
    assert time.monotonic() - started < 2.0
    second = huepose("up", path)
    _until_it_answers(listen, wait_until)
    assert second.poll() is None
    second.send_signal(signal.SIGINT)
    assert second.wait(10.0) == 0


def test_a_worker_that_is_still_starting_ends_too(with_gateway, huepose, wait_until):
    path, _ = with_gateway
    process = huepose("up", path)
    workers = wait_until(lambda: started_by(process.pid))
    process.kill()
    started = time.monotonic()
    wait_until(lambda: not any(map(runs, workers)), 10.0)
    assert time.monotonic() - started < 2.0

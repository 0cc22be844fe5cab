"""The twenty lines of the documentation that read poses without our package, with real sessions."""

import json
import re
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import zenoh

from huepose_protos import encode
from huepose_protos.examples import example
from huepose_protos.messages import PoseMessage
from tests.services.conftest import until
from tests.services.sessions import listening

pytestmark = pytest.mark.live
DOCS = Path(__file__).parents[3] / "docs"


def twenty_lines():
    page = (DOCS / "subscribers.md").read_text()
    return re.search(r"## Without our package.*?```python\n(.*?)```", page, re.DOTALL)[1]


def test_the_twenty_lines_of_the_documentation_report_a_missing_gateway(base_port):
    endpoint = f"tcp/127.0.0.1:{base_port}"
    done = subprocess.run([sys.executable, "-c", twenty_lines(), endpoint], capture_output=True, text=True)
    assert done.returncode == 1
    assert "Unable to connect" in done.stderr
    assert endpoint in done.stderr


def test_the_twenty_lines_of_the_documentation_print_poses(start):
    code = twenty_lines()
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 20
    assert not {"huepose_protos", "msgspec"} & set(re.findall(r"import (\w+)", code))
    one = start()
    process = subprocess.Popen(
        [sys.executable, "-c", code, f"tcp/127.0.0.1:{one.port}"], stdout=subprocess.PIPE, text=True
    )
    got = []
    reader = threading.Thread(target=lambda: got.extend(process.stdout))
    reader.start()
    pose = one.say(1000)
    position = json.loads(json.dumps(pose.translation))
    expected = f"{pose.object} {pose.instance} TRACKING {position} "
    # The stored pose, which comes first, is SUSPECT if this process did not run for a while.
    one.say_until(lambda: any(line.startswith(expected) for line in list(got)))
    process.kill()
    reader.join()
    process.communicate()
    assert got[0].replace("SUSPECT", "TRACKING").startswith(expected)


def test_the_twenty_lines_of_the_documentation_survive_a_gateway_that_does_not_answer(base_port):
    """It is connected, but hangs; then it goes on."""
    endpoint, key = f"tcp/127.0.0.1:{base_port}", "huepose/local/cam0/remote/pose/mustard/0"
    with zenoh.open(listening(endpoint)) as session:
        kept: list[zenoh.Query] = []
        session.declare_queryable("huepose/local/cam0/remote/**", kept.append)
        process = subprocess.Popen(
            [sys.executable, "-c", twenty_lines(), endpoint], stdout=subprocess.PIPE, text=True
        )
        got: list[str] = []
        reader = threading.Thread(target=lambda: got.append(process.stdout.readline()))
        reader.start()
        until(lambda: kept and process.poll() is None)

        def say() -> None:
            time.sleep(0.1)
            session.put(key, encode(example(PoseMessage)))

        until(lambda: got, 10.0, say)
        process.kill()
        reader.join()
        process.communicate()
    assert got[0].startswith(f"{example(PoseMessage).object} ")

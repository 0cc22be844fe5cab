"""What is known of a pipeline whose workers come and go."""

from __future__ import annotations

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage
from huepose_services.runtime.running import Pipeline
from huepose_services.watch import Watch

PIPELINE = Pipeline(base_port=18200, site="lab", camera="cam0", workers=("camera",))


class FakeReader:
    """Gives the messages of `waiting`; `live` as it is set."""

    def __init__(self, endpoints: list[str], *keys: str) -> None:
        self.live, self.waiting = set[str](), list[HealthMessage]()

    def next(self, timeout_s: float) -> HealthMessage | None:
        return self.waiting.pop(0) if self.waiting else None


def says(pid: int, state: str) -> HealthMessage:
    health = example(HealthMessage)
    assert isinstance(health, HealthMessage)
    return msgspec.structs.replace(health, worker="camera", pid=pid, state=state)


class Watched:
    """What is known of the camera when these tokens are there and these messages come."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.watch = Watch(pipeline)

    def after(self, token: str | None, *messages: HealthMessage) -> tuple[int, str] | None:
        reader = self.watch._reader
        assert isinstance(reader, FakeReader)
        reader.live = set() if token is None else {f"huepose/lab/cam0/live/{token}"}
        reader.waiting = list(messages)
        self.watch.look(0.01)
        said = self.watch.view().health.get("camera")
        return None if said is None else (said.pid, said.state)


@pytest.fixture(autouse=True)
def _no_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huepose_services.watch.Reader", FakeReader)


def test_a_worker_that_was_killed_and_started_again_is_not_ready_until_it_says_so() -> None:
    camera = Watched(PIPELINE)
    assert camera.after("camera", says(1, "ready")) == (1, "ready")
    assert camera.after("camera") == (1, "ready")
    camera.after(None)
    assert camera.watch.view().missing == ("camera",)
    assert camera.after("camera") is None
    assert camera.watch.view().missing == ()
    assert camera.after("camera", says(2, "starting")) == (2, "starting")


def test_a_recording_that_is_played_says_how_workers_were_that_are_not_there() -> None:
    camera = Watched(msgspec.structs.replace(PIPELINE, workers=(), folder="/run/huepose"))
    assert camera.after("replay", says(1, "ready")) == (1, "ready")
    assert camera.after("replay") == (1, "ready")

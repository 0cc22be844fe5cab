"""What a watch knows about a pipeline whose workers start and end."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import pytest

from huepose_protos.examples import example
from huepose_protos.messages import HealthMessage, Message, ObjectEntry, ObjectsMessage, PoseMessage
from huepose_services.runtime.running import Pipeline
from huepose_services.watch import Watch

PIPELINE = Pipeline(base_port=18200, site="lab", camera="cam0", workers=("camera",))
POSE = example(PoseMessage)
ENTRY = ObjectEntry(object=POSE.object, max_instances=2, searching=1)


class FakeReader:
    """Gives the messages in `waiting`; a test sets `live`."""

    def __init__(self, endpoints: list[str], *keys: str) -> None:
        self.live, self.waiting = set[str](), list[Message]()

    def next(self, timeout_s: float) -> Message | None:
        return self.waiting.pop(0) if self.waiting else None


def says(pid: int, state: str) -> HealthMessage:
    return msgspec.structs.replace(example(HealthMessage), worker="camera", pid=pid, state=state)


class Watched:
    """A watch on a pipeline; `after`: the camera's pid and state, after these workers have sent these
    messages."""

    def __init__(self, pipeline: Pipeline) -> None:
        self.watch = Watch(pipeline)

    def after(self, there: Sequence[str], *messages: Message) -> tuple[int, str] | None:
        reader = self.watch._reader
        assert isinstance(reader, FakeReader)
        reader.live = {f"huepose/lab/cam0/live/{worker}" for worker in there}
        reader.waiting = list(messages)
        self.watch.look(0.01)
        while reader.waiting:  # on a busy machine the time may be over after one message
            self.watch.look(0.01)
        said = self.watch.view().health.get("camera")
        return None if said is None else (said.pid, said.state)


@pytest.fixture(autouse=True)
def _no_bus(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("huepose_services.watch.Reader", FakeReader)


def test_a_worker_that_was_killed_and_restarted_is_not_ready_until_it_says_so() -> None:
    camera = Watched(PIPELINE)
    assert camera.after(["camera"], says(1, "ready")) == (1, "ready")
    assert camera.after(["camera"]) == (1, "ready")
    camera.after([])
    assert camera.watch.view().missing == ("camera",)
    assert camera.after(["camera"]) is None
    assert camera.watch.view().missing == ()
    assert camera.after(["camera"], says(2, "starting")) == (2, "starting")


@pytest.mark.parametrize(("ends", "poses", "objects"), [("tracker", 0, [ENTRY]), ("reinit", 1, None)])
def test_poses_end_with_their_tracker_and_the_list_of_objects_with_its_worker(
    ends: str, poses: int, objects: list[ObjectEntry] | None
) -> None:
    there = ("tracker", "reinit")
    said = POSE, msgspec.structs.replace(example(ObjectsMessage), objects=[ENTRY])
    pipeline = Watched(PIPELINE)
    pipeline.after(there, *said)
    view = pipeline.watch.view()
    assert (len(view.poses), view.objects) == (1, [ENTRY])
    pipeline.after([worker for worker in there if worker != ends])
    pipeline.after(there)
    view = pipeline.watch.view()
    assert (len(view.poses), view.objects) == (poses, objects)


def test_a_played_recording_shows_the_recorded_state_of_its_workers() -> None:
    camera = Watched(msgspec.structs.replace(PIPELINE, workers=(), folder="/run/huepose"))
    assert camera.after(["replay"], says(1, "ready")) == (1, "ready")
    assert camera.after(["replay"]) == (1, "ready")

"""The re-initialisation worker on a bus, and what it is sent."""

import msgspec
import pytest

from huepose.reinit import ReinitConfig, ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose_protos.examples import example
from huepose_protos.messages import (
    Estimates,
    HealthMessage,
    ObjectEntry,
    ObjectsMessage,
    PoseMessage,
)
from huepose_services.reinit import ReinitWork
from huepose_services.runtime.clock import now_ns
from huepose_services.steering import ObjectList
from tests.services.fake_bus import FakeBus

EPOCH = 5


class _Bus(FakeBus):
    def mug(self):
        """The mug's entry in the last published list."""
        return [m for m in self.said if isinstance(m, ObjectsMessage)][-1].objects[0]


@pytest.fixture
def bus():
    return _Bus("reinit")


@pytest.fixture
def objects():
    return ObjectList([ObjectEntry(object="mug", max_instances=1, searching=1)], ObjectSlot)


@pytest.fixture
def step(bus, objects, monkeypatch):
    """Steps the worker, a tick later each time."""
    bus.work = work = ReinitWork(bus, ReinitLoop(ReinitConfig(), [ObjectSlot("mug", 1, 0.1)]), objects)

    def once():
        work._next_tick_ns = 0
        work.step()

    return once


def pose(instance):
    now = now_ns()
    return msgspec.structs.replace(
        example(PoseMessage),
        **{
            "object": "mug",
            "instance": instance,
            "camera_epoch": EPOCH,
            "capture_ns": now,
            "publish_ns": now,
        },
    )


def answer(bus, **changes):
    """Perception's answer to the request of the worker: nothing found, unless changed."""
    request = next(m for m in bus.said if not isinstance(m, ObjectsMessage))
    now = now_ns()
    message = Estimates(
        publish_ns=now, request_seq=request.seq, camera_epoch=EPOCH, frame_id=9, capture_ns=now, estimates=[]
    )
    return msgspec.structs.replace(message, **changes)


def health(worker, **changes):
    return msgspec.structs.replace(example(HealthMessage), worker=worker, **changes)


def found():
    """The estimate of a new mug, TRACKING."""
    return msgspec.structs.replace(
        example(Estimates).estimates[0],
        object="mug",
        instance=None,
        found=True,
        state="TRACKING",
        quality=0.99,
    )

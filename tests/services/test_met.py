"""An object that is first met, or added anew, while a worker runs: loaded beside the work; that it cannot be
is said once."""

from __future__ import annotations

import threading
from typing import Any, cast

from huepose.support.errors import InputError
from huepose_protos.messages import ObjectEntry, ObjectsMessage
from huepose_services.met import Met
from huepose_services.runtime.bus import Bus
from huepose_services.runtime.clock import now_ns
from tests.services.conftest import until
from tests.services.fake_bus import FakeBus


def test_a_new_object_is_loaded_beside_the_work() -> None:
    there, asked, said = threading.Event(), [], []

    def load(name: str) -> int:
        asked.append(name)
        assert there.wait(10.0)
        return 7

    met = Met(cast(Bus, FakeBus("viewer")), {"can": 3}, load, said.append, "is not drawn")
    assert met.get("can") == 3
    assert met.get("box") is None
    assert met.get("box") is None
    assert list(met) == ["can"]
    there.set()
    until(lambda: met.get("box") is not None)
    assert (met["box"], list(met), asked, said) == (7, ["can", "box"], ["box"], [])


def test_an_object_that_nobody_knows_is_said_once() -> None:
    asked, said = [], []

    def load(name: str) -> int:
        asked.append(name)
        if name == "ghost":
            raise InputError("object 'ghost'", found="no such reference model", fix="Onboard it.")
        raise MemoryError

    met = Met(cast(Bus, FakeBus("viewer")), {}, load, said.append, "is not drawn")
    for _ in range(3):
        assert met.get("ghost") is None
        until(lambda: len(said) == 1)
    assert said == ["ghost is not drawn: object 'ghost': found no such reference model. Onboard it."]
    assert met.get("cup") is None
    until(lambda: len(said) == 2)
    assert said[1] == "cup is not drawn: MemoryError"
    assert asked == ["ghost", "cup"]


def _listed(**added: int) -> ObjectsMessage:
    entries = [ObjectEntry(object=n, max_instances=1, searching=1, added=k) for n, k in added.items()]
    return ObjectsMessage(publish_ns=now_ns(), objects=entries)


def test_what_was_added_again_is_loaded_anew() -> None:
    disk: dict[str, Any] = {"can": "new can", "box": "box"}
    said: list[str] = []
    bus = FakeBus("viewer")
    met = Met(cast(Bus, bus), {"can": "can"}, disk.__getitem__, said.append, "is not drawn")
    bus.arriving[ObjectsMessage].append(_listed(can=4))
    assert met.get("can") == "can", "the first list says how it is"
    bus.arriving[ObjectsMessage] += [_listed(), _listed(box=5)]
    for _ in range(2):
        assert met.get("can") == "can"
    until(lambda: met.get("box") is not None)
    bus.arriving[ObjectsMessage].append(_listed(box=5, can=6))
    assert met.get("can") is None
    assert until(lambda: met.get("can")) == "new can"
    assert met.get("ghost") is None
    until(lambda: said)
    disk["ghost"] = "learnt since"
    bus.arriving[ObjectsMessage].append(_listed(box=5, can=6, ghost=7))
    assert until(lambda: met.get("ghost")) == "learnt since"


def test_what_was_being_loaded_when_it_was_added_again_does_not_count() -> None:
    goes_on, models = threading.Event(), iter(["old", "new"])
    bus = FakeBus("viewer")

    def load(name: str) -> str:
        model = next(models)
        assert goes_on.wait(10.0)
        return model

    met = Met(cast(Bus, bus), {}, load, print, "is not drawn")
    bus.arriving[ObjectsMessage] += [_listed(can=1), _listed(can=2)]
    for _ in range(2):
        assert met.get("can") is None
    goes_on.set()
    assert until(lambda: met.get("can")) == "new"
    assert met["can"] == "new"

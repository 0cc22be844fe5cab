"""An object that is first met while a worker runs: loaded beside the work, once, and said once where not."""

from __future__ import annotations

import threading

from huepose.support.errors import InputError
from huepose_services.met import Met
from tests.services.conftest import until


def test_a_new_object_is_loaded_beside_the_work() -> None:
    there, asked, said = threading.Event(), [], []

    def load(name: str) -> int:
        asked.append(name)
        assert there.wait(10.0)
        return 7

    met = Met({"can": 3}, load, said.append, "is not drawn")
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

    met = Met({}, load, said.append, "is not drawn")
    for _ in range(3):
        assert met.get("ghost") is None
        until(lambda: len(said) == 1)
    assert said == ["ghost is not drawn: object 'ghost': found no such reference model. Onboard it."]
    assert met.get("cup") is None
    until(lambda: len(said) == 2)
    assert said[1] == "cup is not drawn: MemoryError"
    assert asked == ["ghost", "cup"]

"""The list of objects: requests that change it, workers that follow it, and retired instances."""

import threading
import time

import msgspec
import numpy as np
import pytest

from huepose.geometry import Box
from huepose.reinit.types import ObjectSlot
from huepose.support.errors import InputError
from huepose_protos.examples import example
from huepose_protos.messages import (
    MOST_OBJECTS,
    ControlRequest,
    DetectedObject,
    FrameHeader,
    ObjectEntry,
    ObjectsMessage,
    PerceptionRequest,
    PoseMessage,
    RequestedObject,
)
from huepose_services import steering
from huepose_services.boxes import Hints
from huepose_services.following import Follower, Retired, is_over
from huepose_services.steering import ObjectList, Order
from tests.services.fake_bus import FakeBus


def entry(name, **more):
    return ObjectEntry(object=name, **({"max_instances": 1, "searching": 0} | more))


def order(action, name, **more):
    return ControlRequest(publish_ns=1, action=action, object=name, **more)


def load(name, count):
    if name == "ghost":
        raise InputError("object 'ghost'", found="no such reference model", expected="one of mug, jar")
    return ObjectSlot(name, count)


@pytest.fixture
def objects():
    return ObjectList([entry("mug")], load)


def test_a_reset_object_is_listed_as_searched_for_at_once_without_the_old_reason(objects):
    objects.tell("mug", 0, (5, 3), "Hidden.")
    assert objects.decide(order("reset", "mug"))[0]
    (mug,) = objects.entries()
    assert (mug.searching, mug.reason, mug.retired) == (1, "", (5, 3))


def test_a_pose_is_retired_when_its_object_was_reset_or_removed():
    pose = example(PoseMessage)
    name, epoch, number = pose.object, pose.camera_epoch, pose.instance
    assert not is_over(pose, None)
    assert not is_over(pose, [entry(name)])
    assert not is_over(pose, [entry(name, retired=(epoch, number))])
    assert not is_over(pose, [entry(name, retired=(epoch + 1, number + 1))])
    assert is_over(pose, [entry(name, retired=(epoch, number + 1))])
    assert is_over(pose, [entry(f"not_{name}")])


def test_valid_requests_change_the_list(objects):
    assert objects.decide(order("add", "jar", max_instances=2)) == (
        True,
        "jar is searched for, up to 2 instances",
    )
    assert objects.decide(order("reset", "mug", box=(1.0, 2.0, 3.0, 4.0)))[0]
    assert objects.decide(order("remove", "jar"))[0]
    mug = entry("mug", searching=1, resets=1, box=(1.0, 2.0, 3.0, 4.0))
    assert objects.entries() == [mug]
    jar = entry("jar", max_instances=2, searching=2, added=1)
    assert objects.orders() == [
        Order("jar", jar, ObjectSlot("jar", 2)),
        Order("mug", mug, anew=True),
        Order("jar", None),
    ]
    assert objects.orders() == []


@pytest.mark.parametrize(
    ("request_", "reason"),
    [
        (order("add", "ghost"), "no such reference model"),
        (order("add", "mug"), "already"),
        (order("add", "mug", max_instances=2, box=(1.0, 2.0, 3.0, 4.0)), "huepose objects reset mug --box"),
        (order("remove", "jar"), "jar is not searched for; what is: mug"),
        (order("reset", "jar"), "jar is not searched for"),
    ],
)
def test_a_refusal_says_why_and_changes_nothing(objects, request_, reason):
    done, text = objects.decide(request_)
    assert not done
    assert reason in text
    assert objects.entries() == [entry("mug")]
    assert objects.orders() == []


@pytest.mark.parametrize(("action", "name"), [("reset", "mug"), ("add", "jar")])
def test_a_box_outside_of_the_image_is_refused_once_its_size_is_known(objects, action, name):
    outside = order(action, name, box=(900.0, 100.0, 50.0, 50.0))
    objects.picture_size = (640, 480)
    done, text = objects.decide(outside)
    assert not done
    assert "found 900 100 50 50" in text
    assert "in the image of 640 x 480" in text
    assert objects.orders() == []
    objects.picture_size = None
    assert objects.decide(outside)[0]


def test_another_number_of_instances_of_a_known_object_is_accepted(objects):
    assert objects.decide(order("add", "mug", max_instances=3))[0]
    assert [(o.name, o.slot.max_instances) for o in objects.orders()] == [("mug", 3)]


def test_two_objects_that_are_added_at_the_same_time_have_two_numbers(objects, monkeypatch):
    both_are_adding = threading.Barrier(2, timeout=5.0)

    def made(**fields):
        both_are_adding.wait()
        return ObjectEntry(**fields)

    monkeypatch.setattr(steering, "ObjectEntry", made)
    threads = [threading.Thread(target=objects.decide, args=(order("add", name),)) for name in ("jar", "lid")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert {e.added for e in objects.entries()} == {0, 1, 2}


def test_of_two_objects_that_are_added_at_the_same_time_only_one_takes_the_last_place():
    def loads(name, count):
        if name == "jar":
            inner.append(objects.decide(order("add", "lid")))
        return load(name, count)

    inner = []
    objects = ObjectList([entry(f"mug{n}") for n in range(MOST_OBJECTS - 1)], loads)
    done, text = objects.decide(order("add", "jar"))
    assert inner == [(True, "lid is searched for, up to 1 instance")]
    assert not done
    assert text == f"{MOST_OBJECTS} objects are searched for, which is the most: remove one first"
    assert len(objects.entries()) == MOST_OBJECTS


@pytest.mark.parametrize(("second", "done"), [(1, False), (2, True)])
def test_an_object_that_is_added_twice_at_the_same_time_is_added_once(second, done):
    """The second request is then about an object that is searched for already."""

    def loads(name, count):
        if name == "jar" and not inner:
            inner.append(None)
            inner.append(objects.decide(order("add", "jar", max_instances=1)))
        return load(name, count)

    inner = []
    objects = ObjectList([entry("mug")], loads)
    answer = objects.decide(order("add", "jar", max_instances=second))
    assert inner[1] == (True, "jar is searched for, up to 1 instance")
    assert answer[0] == done
    assert ("already" in answer[1]) != done
    assert [(o.entry.added, o.entry.max_instances) for o in objects.orders()] == [(1, 1), (1, 2)][: 1 + done]


def test_an_object_that_is_removed_while_it_is_reset_does_not_come_back(monkeypatch):
    """As by a changed file and a command. The loop does not know it any more."""
    objects, replace = ObjectList([entry("mug")], load), msgspec.structs.replace
    remover = threading.Thread(target=lambda: objects.decide(order("remove", "mug")))

    def slow(*arguments, **changes):
        remover.start()
        remover.join(0.3)
        return replace(*arguments, **changes)

    monkeypatch.setattr(msgspec.structs, "replace", slow)
    assert objects.decide(order("reset", "mug"))[0]
    remover.join()
    assert objects.entries() == []


def _changes(follower, within_s=5.0):
    until = time.monotonic() + within_s
    while not (out := follower.changes()) and time.monotonic() < until:
        time.sleep(0.005)
    return out


def test_a_worker_follows_the_list():
    bus, threads = FakeBus("worker"), []

    def read(name):
        threads.append(threading.current_thread())
        return name.upper()

    follower = Follower(bus, read, ["mug"])
    bus.arriving[ObjectsMessage] = [
        ObjectsMessage(publish_ns=1, objects=[entry("mug", resets=5), entry("jar")])
    ]
    (change,) = _changes(follower)
    assert (change.entry.object, change.added, change.removed) == ("jar", "JAR", False)
    assert threads[0] is not threading.current_thread()
    # The first list says how often the mug was reset so far; only later resets count.
    bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=2, objects=[entry("mug", resets=6)])]
    gone, anew = follower.changes()
    assert (gone.entry.object, gone.removed) == ("jar", True)
    assert (anew.entry.object, anew.added, anew.removed) == ("mug", None, False)
    bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=3, objects=[entry("mug", resets=6)])]
    assert follower.changes() == []


def lists(objects, *orders):
    """The list of objects after these requests, as it is published."""
    for action in orders:
        assert objects.decide(order(action, "mug"))[0]
    return [ObjectsMessage(publish_ns=1, objects=objects.entries())]


def both(follower):
    """The change that removes an object, and the one that adds it again, once its model was read."""
    gone, *new = _changes(follower)
    return [gone, *(new or _changes(follower))]


def test_a_busy_worker_loads_an_object_again_that_was_removed_and_added_meanwhile(objects):
    bus, models = FakeBus("worker"), iter(["of Tuesday", "of Wednesday"])
    follower = Follower(bus, lambda name: next(models), ["mug"])
    bus.arriving[ObjectsMessage] = lists(objects)
    assert follower.changes() == []
    bus.arriving[ObjectsMessage] = lists(objects, "remove", "add")
    gone, new = both(follower)
    assert (gone.entry.object, gone.removed) == ("mug", True)
    assert (new.entry, new.added) == (objects.entries()[0], "of Tuesday")
    bus.arriving[ObjectsMessage] = lists(objects, "reset")
    (anew,) = follower.changes()
    assert (anew.added, anew.removed) == (None, False), "a reset reads no model"
    # The worker that publishes the list was restarted, and has the list as it was published.
    objects = ObjectList(objects.entries(), load)
    bus.arriving[ObjectsMessage] = lists(objects, "remove", "add")
    assert [change.added for change in both(follower)] == [None, "of Wednesday"]


def test_a_model_that_was_read_before_its_object_was_removed_and_added_is_not_used(objects):
    bus, reading, go_on = FakeBus("worker"), iter(["of Monday", "of Tuesday"]), threading.Event()

    def read(name):
        model = next(reading)
        assert go_on.wait(5.0)
        return model

    follower = Follower(bus, read, [])
    bus.arriving[ObjectsMessage] = lists(objects)
    assert follower.changes() == []
    bus.arriving[ObjectsMessage] = lists(objects, "remove", "add")
    assert follower.changes() == []
    go_on.set()
    assert _changes(follower, 0.1) == []
    bus.arriving[ObjectsMessage] = lists(objects)
    assert [change.added for change in _changes(follower)] == ["of Tuesday"]


def test_a_worker_that_was_restarted_does_not_use_a_box_that_was_given_before(objects):
    assert objects.decide(order("add", "jar", box=(1.0, 2.0, 3.0, 4.0)))[0]
    bus = FakeBus("worker")
    follower = Follower(bus, str.upper, ["mug"])
    bus.arriving[ObjectsMessage] = lists(objects)
    (old,) = _changes(follower)
    assert (old.added, old.entry.box) == ("JAR", None)
    for action, name in (("reset", "jar"), ("add", "cup")):
        assert objects.decide(order(action, name, box=(5.0, 6.0, 7.0, 8.0)))[0]
        bus.arriving[ObjectsMessage] = lists(objects)
        (new,) = _changes(follower)
        assert (new.entry.object, new.entry.box) == (name, (5.0, 6.0, 7.0, 8.0)), "it was given just now"


def test_an_object_that_could_not_be_loaded_for_lack_of_memory_is_loaded_with_the_next_list():
    bus, tries = FakeBus("worker"), []

    def read(name):
        tries.append(name)
        if name == "ghost":
            raise InputError("object 'ghost'", found="no such reference model")
        if len(tries) < 3:
            raise MemoryError
        return name.upper()

    follower = Follower(bus, read, [])
    for _ in range(2):
        bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=1, objects=[entry("jar")])]
        assert _changes(follower, 0.1) == []
    assert bus.logged["load"][-1] == "jar is not loaded yet: MemoryError"
    bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=2, objects=[entry("jar"), entry("ghost")])]
    (change,) = _changes(follower)
    assert (change.entry.object, change.added) == ("jar", "JAR")
    # A model that does not exist is not tried again.
    for _ in range(2):
        _changes(follower, 0.1)
        bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=3, objects=[entry("jar"), entry("ghost")])]
    assert tries.count("ghost") == 1


def test_without_a_thread_for_a_new_object_the_other_changes_are_made_and_it_is_loaded_later(monkeypatch):
    bus = FakeBus("worker")
    follower = Follower(bus, str.upper, ["mug", "jar"])

    def listed(*entries):
        bus.arriving[ObjectsMessage] = [ObjectsMessage(publish_ns=1, objects=[entry("mug"), *entries])]

    def start(thread):
        raise RuntimeError("can't start new thread")

    listed(entry("jar"))
    assert follower.changes() == []
    listed(entry("lid"))
    with monkeypatch.context() as patch:
        patch.setattr(threading.Thread, "start", start)
        (gone,) = follower.changes()
    assert (gone.entry.object, gone.removed) == ("jar", True)
    assert bus.logged["load"] == ["lid is not loaded yet: can't start new thread"]
    listed(entry("lid"))
    (come,) = _changes(follower)
    assert (come.entry.object, come.added) == ("lid", "LID")


def test_retired_instances_are_those_of_their_epoch_below_a_number():
    retired = Retired.of([entry("mug", retired=(7, 3))])
    assert [retired.includes("mug", 7, i) for i in (0, 2, 3)] == [True, True, False]
    assert not retired.includes("mug", 8, 0)
    assert not retired.includes("jar", 7, 0)
    assert retired.below == {"mug": (7, 3)}


def test_a_given_box_is_used_until_the_object_has_a_pose():
    header = example(FrameHeader)  # an image of 4 x 2
    anywhere, known = RequestedObject(object="mug", instance=None), RequestedObject(object="mug", instance=0)
    other = RequestedObject(object="jar", instance=None)
    found = [DetectedObject(request=r, box=(0.0, 0.0, 1.0, 1.0), score=0.5) for r in (anywhere, other)]

    def ask(now_ns, *objects):
        request = PerceptionRequest(
            publish_ns=1, seq=1, camera_epoch=None, deadline_ns=9, objects=list(objects)
        )
        boxes = hints.applied(found, header, request, now_ns)
        return {d.request.object: d.box for d in boxes}

    hints = Hints()
    hints.point("mug", Box(1.0, 0.0, 9.0, 2.0), now_ns=0)
    assert ask(1, anywhere, other) == {"jar": (0.0, 0.0, 1.0, 1.0), "mug": (1.0, 0.0, 3.0, 2.0)}
    assert ask(2, known, other)["mug"] == (0.0, 0.0, 1.0, 1.0)
    assert ask(3, anywhere)["mug"] == (0.0, 0.0, 1.0, 1.0), "it had a pose: the hint is used up"
    hints.point("mug", Box(1.0, 0.0, 9.0, 2.0), now_ns=0, retired=(header.camera_epoch, 1))
    ask(1, known, other)
    assert ask(2, anywhere)["mug"] == (1.0, 0.0, 3.0, 2.0), "the instance that had a pose ended by the reset"
    assert ask(int(np.int64(10_000_000_000)), anywhere)["mug"] == (0.0, 0.0, 1.0, 1.0), "too long ago"

"""Rings of one, queues, bad bytes: with real sessions."""

import threading
import time
from itertools import count

import msgspec
import numpy as np
import pytest
import zenoh

from huepose_protos import decode, encode
from huepose_protos.buffers import frame_images, pack
from huepose_protos.examples import example, images
from huepose_protos.messages import FrameHeader, ObjectsMessage, PoseMessage
from huepose_services.following import Memory, recall
from huepose_services.runtime import session
from huepose_services.runtime.clock import now_ns
from huepose_services.runtime.config import CHAIN, BusConfig, Config
from huepose_services.runtime.session import MIB, lock_limit, pool_fits, pool_size
from tests.services.conftest import until
from tests.services.sessions import close_bus, open_bus

pytestmark = pytest.mark.live

POSE = example(PoseMessage)
HEADER = example(FrameHeader)


@pytest.fixture
def buses(base_port):
    """Camera and tracker ends of a bus."""
    config = Config(bus=BusConfig(base_port=base_port))
    before = threading.active_count()
    opened = [open_bus(config, worker) for worker in ("camera", "tracker")]
    yield opened
    for bus in opened:
        close_bus(bus)
    assert threading.active_count() <= before + 1, "threads of closed subscriptions are left"


def _numbered(i):
    return msgspec.structs.replace(POSE, frame_id=i)


def _next_pose(bus, queue):
    return until(lambda: bus.take(queue, PoseMessage), act=lambda: bus.inbox.wait(0.1))


def _saying(say, bus):
    """A function that publishes something and waits a moment for it."""

    def act():
        say()
        bus.inbox.wait(0.05)

    return act


def _until_heard(publish, place, bus):
    """Publishes until a message arrives in the place, then takes all messages out of it."""
    sent = count()
    until(lambda: place, act=_saying(lambda: publish(_numbered(next(sent))), bus))
    last = next(sent)
    publish(_numbered(last))
    until(lambda: (taken := bus.take(place, PoseMessage)) is not None and taken.frame_id == last)


def _newest(place, kind):
    """The newest message in a place, which stays there; None if it is empty."""
    sample = next(reversed(place._samples), None)
    return None if sample is None else decode((sample.attachment or sample.payload).to_bytes(), kind)


def test_a_reader_without_memory_for_one_message_gets_the_next(buses):
    camera, tracker = buses
    queue = tracker.inbox.queue(tracker.keys.pose("x", 1))
    key = camera.keys.pose("x", 1)
    take, scarce = queue._put, []

    def put(sample):
        if scarce and scarce.pop():
            raise MemoryError
        take(sample)

    queue._put = put
    _until_heard(lambda message: camera.put(key, message), queue, tracker)
    drops = tracker.inbox.drops
    scarce.append(True)
    camera.put(key, _numbered(1))
    camera.put(key, _numbered(2))
    tracker.inbox.wait(5.0)
    assert tracker.take(queue, PoseMessage).frame_id == 2
    assert tracker.inbox.drops == drops + 1


def test_a_slow_reader_of_a_ring_gets_the_newest(buses):
    camera, tracker = buses
    ring = tracker.inbox.ring("t/ring")
    _until_heard(lambda m: camera.put("t/ring", m), ring, tracker)
    skipped = ring.skipped
    for i in range(1, 51):
        camera.put("t/ring", _numbered(i))
        if i == 1:
            until(lambda: ring)
    # Some of a burst may be dropped on the way; the last one waits for its place.
    how = {"priority": zenoh.Priority.REAL_TIME, "congestion_control": zenoh.CongestionControl.BLOCK}
    camera.session.put("t/ring", encode(_numbered(51)), **how)
    until(lambda: _newest(ring, PoseMessage).frame_id == 51)
    assert tracker.take(ring, PoseMessage).frame_id == 51
    assert tracker.take(ring, PoseMessage) is None
    assert ring.skipped > skipped


def test_a_queue_keeps_everything_in_order(buses):
    camera, tracker = buses
    queue = tracker.inbox.queue("t/queue")
    _until_heard(lambda m: camera.put_control("t/queue", m), queue, tracker)
    for i in range(1000):
        camera.put_control("t/queue", _numbered(i))
    assert [_next_pose(tracker, queue).frame_id for _ in range(1000)] == list(range(1000))
    assert queue.skipped == 0


def test_publishers_below_a_key_end_and_begin_again_when_needed(buses):
    camera, tracker = buses
    queue = tracker.inbox.queue("t/**")
    _until_heard(lambda m: camera.put("t/x/1", m), queue, tracker)
    for key in ("t/x/2", "t/xy/1"):
        camera.put(key, _numbered(1))
    camera.forget("t/x")
    assert list(camera._publishers) == ["t/xy/1"]
    camera.put("t/x/1", _numbered(2))
    assert [_next_pose(tracker, queue).frame_id for _ in range(3)] == [1, 1, 2]


def test_bad_bytes_are_counted_and_the_next_good_message_is_read(buses, capfd):
    camera, tracker = buses
    queue = tracker.inbox.queue("t/bad")
    _until_heard(lambda m: camera.put("t/bad", m), queue, tracker)
    good = encode(_numbered(7))
    for data in [b"", b"\xc1", good[:-1], good + b"x" * 5000, b"\xff" * 100]:
        camera.session.put("t/bad", data)
    camera.session.put("t/bad", good)
    assert _next_pose(tracker, queue).frame_id == 7
    assert tracker.health.counters["wire_errors"] == 5
    assert capfd.readouterr().err.count("dropped a message on t/bad") == 1


def test_pixels_arrive_with_their_header_and_by_shared_memory(buses):
    camera, tracker = buses
    if not pool_fits(6 * MIB, lock_limit()):
        pytest.skip("the limit of locked memory is too low for a pool of frames")
    key = tracker.keys.frame
    ring = tracker.inbox.ring(key)
    rng = np.random.default_rng(0)
    color = rng.integers(0, 255, (480, 640, 3), dtype=np.uint8)
    depth = rng.integers(0, 65535, (480, 640), dtype=np.uint16)
    specs, payload = pack({"color": color, "depth": depth})
    size = msgspec.structs.replace(HEADER.intrinsics, width=640, height=480)
    header = msgspec.structs.replace(HEADER, buffers=specs, intrinsics=size)
    say = _saying(lambda: camera.put_pixels(key, header, payload), tracker)
    # The first frames, before the pool is made, go by TCP.
    while tracker.health.counters.get("frames_by_shared_memory", 0) < 5:
        taken = until(lambda: tracker.take_with_payload(ring, FrameHeader), act=say)
    got_color, got_depth = frame_images(*taken)
    assert (got_color == color).all()
    assert (got_depth == depth).all()
    assert tracker.health.shared_memory is True


def test_a_payload_without_a_header_is_refused(buses):
    camera, tracker = buses
    ring = tracker.inbox.ring(tracker.keys.frame)
    pixels = pack(images())[1]
    until(lambda: ring, act=_saying(lambda: camera.session.put(tracker.keys.frame, pixels), tracker))
    assert tracker.take_with_payload(ring, FrameHeader) is None
    assert tracker.health.counters["wire_errors"] == 1


def test_a_ring_that_does_not_wake_leaves_the_loop_asleep(buses):
    camera, tracker = buses
    ring = tracker.inbox.ring("t/quiet", wakes=False)
    until(lambda: ring._samples, act=_saying(lambda: camera.put("t/quiet", POSE), tracker))
    start = time.monotonic()
    tracker.inbox.wait(0.2)
    assert time.monotonic() - start >= 0.19
    assert tracker.take(ring, PoseMessage) == POSE


@pytest.mark.parametrize(
    ("limit_kib", "pool_mib", "fits"), [(8192, 6, True), (8192, 7, False), (64, 1, False), (None, 999, True)]
)
def test_a_pool_must_fit_the_limit_of_locked_memory(limit_kib, pool_mib, fits):
    assert pool_fits(pool_mib * MIB, None if limit_kib is None else limit_kib * 1024) is fits


def test_a_camera_started_again_needs_room_for_the_pool_that_readers_keep():
    assert not pool_fits(6 * MIB, 8 * MIB, pools=2)
    assert pool_fits(2 * MIB, 8 * MIB, pools=2)


def test_the_list_of_objects_is_kept_for_workers_that_come_back(buses):
    camera, tracker = buses
    memory = Memory(tracker)
    assert recall(camera) == []
    message = example(ObjectsMessage)
    memory.keep(message)
    assert recall(camera) == message.objects


def test_without_a_limit_the_pool_grows_with_its_readers():
    watched = Config(workers=(*CHAIN, "viewer"))
    assert pool_size(Config(), 8 * MIB) == pool_size(Config(), None) == 6 * MIB
    assert pool_size(watched, 8 * MIB) == 6 * MIB
    assert pool_size(watched, None) == 9 * MIB


def test_a_camera_says_that_its_pool_does_not_fit_into_shared_memory(monkeypatch, base_port):
    """As in a container with little of it."""
    config = Config(bus=BusConfig(base_port=base_port))
    monkeypatch.setattr(session, "lock_limit", lambda: None)
    warnings = []
    for free_mib in (5, 7):
        monkeypatch.setattr(session, "shared_memory_free", lambda free_mib=free_mib: free_mib * MIB)
        opened, warning = session.open_worker_session(config, "camera")
        opened.close()
        warnings.append(warning)
    off = "shared memory is off: frames need 6144 KiB in /dev/shm, 5120 KiB are free; frames go by the socket"
    assert warnings == [off, None]


@pytest.mark.parametrize("name", ["publish_ns", "capture_ns"])
def test_what_says_it_is_of_the_future_is_refused(buses, name):
    camera, tracker = buses
    queue = tracker.inbox.queue("t/future")
    _until_heard(lambda m: camera.put_control("t/future", m), queue, tracker)
    camera.put_control("t/future", msgspec.structs.replace(POSE, **{name: 2**63 - 1}))
    camera.put_control("t/future", _numbered(7))
    assert _next_pose(tracker, queue).frame_id == 7
    assert tracker.health.counters["wire_errors"] == 1


def test_frames_of_a_second_camera_replace_none_and_are_reported(buses):
    camera, tracker = buses
    ring = tracker.frames()
    specs, payload = pack(images())
    first = msgspec.structs.replace(HEADER, buffers=specs)
    until(lambda: ring, act=_saying(lambda: camera.put_pixels(camera.keys.frame, first, payload), tracker))
    second = msgspec.structs.replace(HEADER, buffers=specs, camera_epoch=2)
    for number in range(30):
        mine = msgspec.structs.replace(HEADER, buffers=specs, frame_id=number)
        camera.put_pixels(camera.keys.frame, mine, payload)
        camera.put_pixels(camera.keys.frame, second, payload)
        until(lambda number=number: tracker._camera.refused > number)
        if number in (9, 19, 29):
            tracker.say_health()
    header, _ = tracker.take_with_payload(ring, FrameHeader)
    assert (header.camera_epoch, header.frame_id) == (HEADER.camera_epoch, 29)
    health = tracker.health.message()
    assert health.counters["frames_of_another_camera"] >= 20
    assert any("second camera" in warning for warning in health.warnings)


def test_an_older_frame_that_comes_later_replaces_none(buses):
    camera, tracker = buses
    ring = tracker.frames()
    specs, payload = pack(images())
    now = now_ns()

    def say(number, capture_ns):
        header = msgspec.structs.replace(HEADER, buffers=specs, frame_id=number, capture_ns=capture_ns)
        camera.put_pixels(camera.keys.frame, header, payload)

    until(lambda: ring, act=_saying(lambda: say(5, now), tracker))
    say(6, now + 1)
    until(lambda: _newest(ring, FrameHeader).frame_id == 6)
    for earlier, (number, back_ns) in enumerate(((4, 1_000_000), (3, 2_000_000))):
        say(number, now - back_ns)
        until(lambda earlier=earlier: tracker._out_of_order > earlier)
    tracker.say_health()
    assert tracker.health.counters["frames_out_of_order"] == 2
    header, _ = tracker.take_with_payload(ring, FrameHeader)
    assert header.frame_id == 6


def test_workers_are_reported_as_they_start_after_those_that_run_already(buses):
    camera, tracker = buses
    there, gone = (camera.session.liveliness().declare_token(camera.keys.live(w)) for w in ("one", "gone"))
    tokens, begun = tracker.inbox.liveliness(tracker.keys.live()), []

    def heard():
        begun.extend(iter(lambda: tracker.take_begun(tokens), None))
        return set(begun)

    until(lambda: heard() == {"one", "gone"})
    gone.undeclare()
    later = camera.session.liveliness().declare_token(camera.keys.live("later"))
    until(lambda: "later" in heard())
    assert sorted(begun) == ["gone", "later", "one"]
    there.undeclare()
    later.undeclare()

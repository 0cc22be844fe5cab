"""pipeline.yaml is read again: what is applied at once, what waits for the next start, and errors."""

import io
import json
import os
import pty
import signal
import sys
import time
from types import SimpleNamespace

import msgspec
import pytest

from huepose.reinit import ReinitLoop
from huepose.reinit.types import ObjectSlot
from huepose.support.errors import InputError
from huepose_protos.messages import ObjectEntry
from huepose_services.reinit import ReinitWork
from huepose_services.runtime.config import CHAIN, Config
from huepose_services.runtime.config_file import load
from huepose_services.runtime.health import Health
from huepose_services.runtime.log import Log
from huepose_services.runtime.reload import LIVE, Reload, changed
from huepose_services.steering import ObjectList
from tests.services.fake_bus import FakeBus


@pytest.fixture
def worker(tmp_path):
    """A function of a worker's name that gives another: it writes the file, has it read again, and gives the
    applied configuration, the log and the warnings."""
    path = tmp_path / "pipeline.yaml"
    path.write_text("{}")

    def make(name):
        out, health, taken = io.StringIO(), Health(name), []
        reload = Reload(name, path, load(path), Log(name, out), health)

        def write(text):
            out.truncate(0)
            path.write_text(text if isinstance(text, str) else json.dumps(text))
            reload.take_over(lambda config: taken.append(config) or [])
            return taken[-1] if taken else None, out.getvalue(), health.message().warnings

        return write

    return make


def test_live_keys_are_applied_and_the_others_are_listed_as_waiting(worker):
    write = worker("tracker")
    config, said, warnings = write({"tracker": {"max_age_ms": 200, "history_frames": 30}, "site": "roof"})
    assert config.tracker.max_age_ms == 200.0
    assert "was read again: tracker.max_age_ms (300.0 > 200.0)" in said
    assert warnings == [
        'changes that wait for the next start: site ("local" > "roof"), tracker.history_frames (20 > 30)'
    ]
    # The file is compared with the values at the start: where they are equal again, nothing waits.
    config, said, warnings = write({"tracker": {"max_age_ms": 250}})
    assert config.tracker.max_age_ms == 250.0
    assert warnings == []


def test_only_the_workers_that_a_shared_section_concerns_say_that_it_waits(worker):
    text = {"networks": {"threads": 3}, "link": {"listen": "0.0.0.0:7500"}}
    writes = {name: worker(name) for name in ("tracker", "detector", "uplink")}
    said = {name: write(text)[2] for name, write in writes.items()}
    assert said["tracker"] == []
    assert "networks.threads" in said["detector"][0]
    assert "link" not in said["detector"][0]
    assert "link.listen" in said["uplink"][0]


def test_the_gateway_applies_how_old_a_pose_may_be(worker):
    config, said, warnings = worker("gateway")({"tracker": {"max_age_ms": 200}})
    assert config.tracker.max_age_ms == 200.0
    assert "was read again: tracker.max_age_ms (300.0 > 200.0)" in said
    assert warnings == []


def test_of_long_values_the_part_that_differs_is_shown(worker):
    said = worker("huepose")({"workers": [*CHAIN, "gateway", "viewer"]})[2][0]
    assert said.endswith('workers (...gmenter","estimator"] > ...gmenter","estimator","gateway","viewer"])')


def test_the_worker_reinit_gets_the_file_even_if_it_is_unchanged(worker):
    config, said, warnings = worker("reinit")({})
    assert config is not None
    assert (said, warnings) == ("", [])


def test_objects_that_wait_are_not_reported_as_applied(worker):
    """A change from all models to some: the worker with the list of objects refuses it itself."""
    write = worker("reinit")
    for _ in range(2):
        assert write({"objects": [{"name": "mug"}]})[1] == ""
    assert "was read again: reinit.rate_hz" in write({"reinit": {"rate_hz": 4}})[1]


def test_keys_of_other_workers_are_not_reported(worker):
    write = worker("segmenter")
    assert write({"tracker": {"max_age_ms": 200, "history_frames": 30}, "restarts": {"limit": 3}}) == (
        *(None, ""),
        [],
    )


def test_a_wrong_file_changes_nothing_and_is_reported(worker):
    write = worker("tracker")
    config, said, warnings = write({"tracker": {"max_age_ms": -1}})
    assert config is None
    assert "is not taken over" in said
    assert "tracker.max_age_ms" in warnings[0]
    assert write({})[2] == []


def test_every_live_key_is_one_of_the_configuration():
    other = {"objects": [{"name": "mug"}], "gateway": {"tls": {"readers": ["robot"]}}}
    before = {"gateway": {"tls": dict.fromkeys(("authority", "certificate", "key"), "x")}}
    merged = {"gateway": {"tls": before["gateway"]["tls"] | other["gateway"]["tls"]}}
    keys = {k for k, _ in changed(*(msgspec.convert(d, Config) for d in (before, other | merged)))}
    assert keys == {"objects", "gateway.tls.readers"}
    for key in set.union(*map(set, LIVE.values())) - keys:
        section, name = key.split(".")
        assert name in getattr(Config(), section).__struct_fields__


def test_objects_come_and_go_with_the_file_and_those_added_by_hand_stay():
    def slot(name, count):
        if name in missing:
            raise InputError("object 'ghost'", found="no such reference model", expected="one of mug, jar")
        return ObjectSlot(name, count)

    missing = {"ghost"}
    entries = [ObjectEntry(object=name, max_instances=1, searching=0) for name in ("mug", "jar", "by hand")]
    objects = ObjectList(entries, slot)
    loop = SimpleNamespace(config=None)

    def config(**counts):
        items = [{"name": name, "max_instances": count} for name, count in counts.items()]
        return msgspec.convert({"objects": items, "reinit": {"rate_hz": 4}}, Config)

    bus = FakeBus("reinit")
    work = ReinitWork(bus, loop, objects, config(mug=1, jar=1).objects)
    assert work.reload(config(mug=3, lid=1, ghost=1)) == []
    _settled(work)
    (refused,) = bus.health.message().warnings
    assert "ghost" in refused
    assert {e.object: e.max_instances for e in objects.entries()} == {"mug": 3, "lid": 1, "by hand": 1}
    assert loop.config.period_ms == 250.0
    missing.clear()
    assert work.reload(config(mug=3, lid=1, ghost=1)) == [], "it is tried again"
    _settled(work)
    assert bus.health.message().warnings == []
    assert {e.object for e in objects.entries()} == {"mug", "lid", "ghost", "by hand"}
    assert work.reload(config(mug=3, lid=1)) == []
    _settled(work)
    assert {e.object for e in objects.entries()} == {"mug", "lid", "by hand"}
    assert "objects" in work.reload(Config())[0]


def test_many_objects_are_loaded_in_many_steps():
    """Else the worker is silent for so long that it is killed as hung."""
    loaded = []

    def slot(name, count):
        loaded.append(name)
        return ObjectSlot(name, count)

    entries = [ObjectEntry(object="mug", max_instances=1, searching=0)]
    config = msgspec.convert({"objects": [{"name": n} for n in ("mug", "jar", "lid", "cup")]}, Config)
    work = ReinitWork(FakeBus("reinit"), ReinitLoop(), ObjectList(entries, slot), config.objects[:1])
    counts = []
    for call in (lambda: work.reload(config), work.step, work.step, work.step, work.step):
        call()
        counts.append(len(loaded))
    assert counts == [0, 1, 2, 3, 3]


def _settled(work):
    """Let a worker change all objects as its file says."""
    while work._file._orders:
        work._file.step()


def test_after_a_restart_missing_objects_of_the_file_are_added_when_it_is_read_again():
    """The list is older than the file; an object that is not in the file may be added by hand, and stays."""
    entries = [ObjectEntry(object=name, max_instances=1, searching=0) for name in ("mug", "jar")]
    objects = ObjectList(entries, ObjectSlot)
    config = msgspec.convert({"objects": [{"name": "mug", "max_instances": 2}, {"name": "lid"}]}, Config)
    work = ReinitWork(FakeBus("reinit"), SimpleNamespace(config=None), objects, config.objects)
    assert work.reload(config) == []
    _settled(work)
    assert {e.object: e.max_instances for e in objects.entries()} == {"mug": 2, "jar": 1, "lid": 1}
    work = ReinitWork(FakeBus("reinit"), work._loop, ObjectList(entries[1:], ObjectSlot), config.objects)
    assert work.reload(config) == [], "also if it knows none of the file's objects"
    _settled(work)
    assert {e.object for e in work._objects.entries()} == {"mug", "jar", "lid"}


@pytest.mark.parametrize(
    ("before", "code"), [("SIG_DFL", -signal.SIGTERM), ("SIG_IGN", 0)], ids=["terminal", "nohup"]
)
def test_closing_the_terminal_ends_the_process_unless_it_runs_under_nohup(before, code):
    program = (
        f"import signal, time; signal.signal(signal.SIGHUP, signal.{before})\n"
        "from huepose_services.runtime.reload import asked_again\n"
        "again = asked_again(); signal.raise_signal(signal.SIGHUP); assert again() and not again()\n"
        "print('reads again', flush=True)\nwhile not again(): time.sleep(0.1)"
    )  # one long sleep would not see a signal that comes right before it
    pid, terminal = pty.fork()
    if pid == 0:
        os.execv(sys.executable, [sys.executable, "-c", program])
    said = b""
    while b"reads again\r\n" not in said:  # unbuffered, the end of the line comes by itself
        said += os.read(terminal, 1000)
    os.close(terminal)
    deadline = time.monotonic() + 10.0
    while (ended := os.waitpid(pid, os.WNOHANG))[0] == 0:
        assert time.monotonic() < deadline
        time.sleep(0.05)
    assert os.waitstatus_to_exitcode(ended[1]) == code


@pytest.mark.live
def test_a_running_pipeline_reads_its_file_again(pipeline, huepose):
    path = pipeline(once=False, rate=20)
    process = huepose("up", path)
    said = []
    while "all workers are ready" not in "".join(said):
        said.append(process.stderr.readline())
    settings = json.loads(path.read_text())
    settings["camera"]["rate"] = 10
    settings["restarts"] = {"limit": 9}
    path.write_text(json.dumps(settings))
    process.send_signal(signal.SIGHUP)
    while "camera.rate (20.0 > 10.0)" not in (text := "".join(said)):
        said.append(process.stderr.readline())
    assert "restarts.limit (5 > 9)" in text
    assert process.poll() is None
    process.terminate()
    assert process.wait(10.0) == 0

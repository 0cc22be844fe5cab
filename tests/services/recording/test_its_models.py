"""What is drawn of a recording that is played: the objects of its own pipeline, and no others."""

import argparse
import json

import msgspec
import pytest

from huepose.support.errors import InputError
from huepose_protos.examples import example
from huepose_protos.messages import MemoryMessage, ObjectsMessage
from huepose_services import builtin
from huepose_services.cli.view import _drawn
from huepose_services.recording.its_models import load_one
from huepose_services.runtime.config import Config
from huepose_services.runtime.running import Pipeline, noted
from tests.services.conftest import until
from tests.services.fake_bus import FakeBus, listed

from .conftest import KEY, NAME, parts


@pytest.fixture(autouse=True)
def nothing_is_learnt(monkeypatch):
    def learnt(*_):
        pytest.fail("built-in objects are learnt")

    monkeypatch.setattr(builtin, "builtin_bundles", learnt)


def _recorded(path, **config):
    """A recording of a pipeline of that configuration."""
    out = parts(path)
    told = json.loads(msgspec.json.encode(Config())) | config
    out.message(
        KEY + "tracker/memory", msgspec.structs.replace(example(MemoryMessage), config=json.dumps(told))
    )
    out.close()
    return out.path


def test_its_own_models_are_found_where_its_pipeline_had_them(followed):
    assert load_one(followed.path, NAME).name == NAME


def test_so_are_those_of_a_version_that_had_other_keys(followed, tmp_path):
    path = _recorded(tmp_path / "old", bundles=str(followed.bundles), colour={"of": "old"})
    assert load_one(path, NAME).name == NAME


def test_of_models_that_moved_it_is_said_how_to_name_their_folder(tmp_path):
    path = _recorded(tmp_path / "moved", bundles=str(tmp_path / "gone"))
    with pytest.raises(
        InputError, match=r"gone: found no such folder.*replay \S*/moved.mcap --config PIPELINE"
    ):
        load_one(path, NAME)


def test_for_a_name_that_no_built_in_object_has_none_is_learnt(tmp_path):
    out = parts(tmp_path / "poses")
    out.close()
    with pytest.raises(InputError, match=r"'my_box': found no such built-in .*--config PIPELINE.yaml"):
        load_one(out.path, "my_box")


def test_what_is_looked_for_in_a_recording_that_is_played_is_drawn(followed, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    arguments = argparse.Namespace(config=None, pipeline=None, pairs=False)
    with noted(Pipeline(base_port=29347, site="lab", camera="cam0", file=str(followed.path))):
        bus = FakeBus("view")
        drawn, follower = _drawn(bus, Config(), arguments)
        assert list(drawn) == []
        bus.arriving[ObjectsMessage].append(listed(NAME, "my_box"))
        (said,) = until(lambda: follower.keep_up(drawn) or (drawn.get(NAME) and bus.logged["load"]))
    assert said.startswith("object 'my_box': found no such reference model")
    assert said.endswith(f"huepose replay {followed.path} --config PIPELINE.yaml.")

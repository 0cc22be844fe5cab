"""Which objects the viewer draws of a played recording: those of its own pipeline, and no others."""

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
def no_model_is_made(monkeypatch):
    def made(*_):
        pytest.fail("built-in models are made")

    monkeypatch.setattr(builtin, "builtin_bundles", made)


def _recorded(path, **config):
    """A recording of a pipeline of that configuration."""
    out = parts(path)
    settings = json.loads(msgspec.json.encode(Config())) | config
    out.message(
        KEY + "tracker/memory", msgspec.structs.replace(example(MemoryMessage), config=json.dumps(settings))
    )
    out.close()
    return out.path


def test_models_are_found_in_the_folder_of_the_recorded_pipeline(followed):
    assert load_one(followed.path, NAME).name == NAME


def test_models_are_also_found_if_the_recorded_configuration_has_other_keys(followed, tmp_path):
    path = _recorded(tmp_path / "old", bundles=str(followed.bundles), colour={"of": "old"})
    assert load_one(path, NAME).name == NAME


def test_if_models_moved_the_error_says_how_to_name_their_folder(tmp_path):
    path = _recorded(tmp_path / "moved", bundles=str(tmp_path / "gone"))
    with pytest.raises(
        InputError, match=r"gone: found no such folder.*replay \S*/moved.mcap --config PIPELINE"
    ):
        load_one(path, NAME)


def test_no_model_is_made_for_a_name_that_no_built_in_object_has(tmp_path):
    out = parts(tmp_path / "poses")
    out.close()
    with pytest.raises(InputError, match=r"'my_box': found no such built-in .*--config PIPELINE.yaml"):
        load_one(out.path, "my_box")


def test_objects_that_a_played_recording_searches_for_are_drawn(followed, tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    arguments = argparse.Namespace(config=None, pipeline=None, pairs=False)
    with noted(Pipeline(base_port=29347, site="lab", camera="cam0", file=str(followed.path))):
        bus = FakeBus("view")
        drawn, follower = _drawn(bus, Config(), True, arguments)
        assert list(drawn) == []
        bus.arriving[ObjectsMessage].append(listed(NAME, "my_box"))
        (said,) = until(lambda: follower.keep_up(drawn) or (drawn.get(NAME) and bus.logged["load"]))
    assert said.startswith("object 'my_box': found no such reference model")
    assert said.endswith(f"huepose replay {followed.path} --config PIPELINE.yaml.")

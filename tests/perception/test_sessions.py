"""Opening and running networks: digests, broken files, providers, fixed and free sizes."""

import hashlib
from pathlib import Path

import numpy as np
import pytest

from huepose.perception import sessions
from huepose.perception.sessions import NetworkSettings, open_network
from huepose.support.errors import InputError
from tests.perception import networks


@pytest.fixture
def fixed(tmp_path):
    return networks.identity(tmp_path / "fixed.onnx", (1, 3, 4, 4))


@pytest.fixture
def free(tmp_path):
    return networks.identity(tmp_path / "free.onnx", (1, 3, "height", "width"))


def test_the_chosen_provider_and_the_inputs_are_named(fixed):
    network = open_network(fixed)
    assert network.provider == "cpu"
    assert str(network.inputs[0]) == "images float 1 x 3 x 4 x 4"
    assert network.inputs[0].fixed


@pytest.mark.parametrize("kind", ["fixed", "free"])
def test_each_run_gives_its_own_answer(kind, request):
    network = open_network(request.getfixturevalue(kind))
    rng = np.random.default_rng(0)
    feeds = [rng.random((1, 3, 4, 4), dtype=np.float32) for _ in range(3)]
    answers = [network.run({"images": feed})["output"] for feed in feeds]
    # A later run must not overwrite the answer or the input of an earlier one.
    for feed, answer in zip(feeds, answers, strict=True):
        assert np.array_equal(feed, answer)


def test_a_wrong_size_or_name_is_an_error_and_not_a_broadcast(fixed):
    network = open_network(fixed)
    with pytest.raises(InputError, match="found 1 x 3 x 1 x 1"):
        network.run({"images": np.zeros((1, 3, 1, 1), np.float32)})
    with pytest.raises(InputError, match="expected images float 1 x 3 x 4 x 4"):
        network.run({"image": np.zeros((1, 3, 4, 4), np.float32)})


def test_a_network_that_cannot_be_run_is_an_error_that_names_the_file(tmp_path):
    """As an export with free sizes that works at the size of the export only."""
    path = networks.sam_encoder(tmp_path / "free.onnx", ("height", "width"))
    network = open_network(path)
    with pytest.raises(InputError, match=r"free.onnx: found .*Reshape.*can be run with image 1 x 3 x 640 x"):
        network.run({"image": np.zeros((1, 3, 640, 640), np.float32)})


def test_an_error_of_a_network_that_has_worked_is_no_wrong_input(free, monkeypatch):
    """A worker that ends with it, as when a GPU has no memory left, must be started again."""
    network = open_network(free)
    feed = {"images": np.zeros((1, 3, 4, 4), np.float32)}
    network.run(feed)

    def fails(feeds):
        raise RuntimeError("CUDA failure 2: out of memory")

    monkeypatch.setattr(network, "_answer", fails)
    with pytest.raises(RuntimeError, match="out of memory") as caught:
        network.run(feed)
    assert not isinstance(caught.value, InputError)


def test_the_digest_is_checked_before_anything_else(fixed):
    right = hashlib.sha256(fixed.read_bytes()).hexdigest()
    open_network(fixed, sha256=right)
    with pytest.raises(InputError, match=f"SHA-256 {right}; expected 0000"):
        open_network(fixed, sha256="0" * 64)


@pytest.mark.parametrize("content", [b"", b"not a network", None])
def test_a_broken_file_is_an_error_at_once(fixed, content):
    fixed.write_bytes(fixed.read_bytes()[:-20] if content is None else content)
    with pytest.raises(InputError, match="expected a network in the ONNX format"):
        open_network(fixed)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match="found no file"):
        open_network(tmp_path / "nothing.onnx")


def test_missing_providers_are_skipped_but_never_silently_replaced(fixed):
    assert open_network(fixed, NetworkSettings(providers=("tensorrt", "cuda", "cpu"))).provider == "cpu"
    with pytest.raises(InputError, match="expected one of tensorrt"):
        open_network(fixed, NetworkSettings(providers=("tensorrt",)))


def test_engines_are_kept_in_the_cache_and_a_place_that_cannot_be_one_is_an_error(tmp_path):
    settings = NetworkSettings(cache=tmp_path / "new" / "engines")
    assert sessions._options("tensorrt", settings, True)["trt_engine_cache_path"] == str(settings.cache)
    assert settings.cache.is_dir()
    with pytest.raises(InputError, match=r"/proc/engines: found .*Set networks\.cache to one"):
        sessions._options("tensorrt", NetworkSettings(cache=Path("/proc/engines")), True)


def test_threads_are_those_of_the_settings(fixed):
    network = open_network(fixed, NetworkSettings(threads=3))
    assert network._session.get_session_options().intra_op_num_threads == 3

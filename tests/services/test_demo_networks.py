"""The demo with a segmenter of SAM whose answers are known."""

import pytest
import yaml

from huepose.support.errors import InputError
from huepose_services import networks as deployed
from huepose_services.cli.main import main
from huepose_services.demo.run import _complaints, pipeline
from tests.perception import networks
from tests.services.conftest import parse


def test_a_missing_network_is_reported_before_anything_starts(tmp_path, monkeypatch, refused):
    monkeypatch.setenv("HUEPOSE_NETWORKS", str(tmp_path))
    monkeypatch.setattr("huepose_services.demo.run.load_models", lambda folder, names: {})
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert "`huepose models fetch nanosam-encoder` fetches it" in refused(["demo", "--segmenter", "sam"])
    assert not list(tmp_path.glob("huepose-demo-*"))


@pytest.mark.parametrize(
    "why", [InputError("port 17447", found="another pipeline"), OSError(5, "a terminal that is closed")]
)
def test_a_demo_that_cannot_go_on_leaves_no_folder(why, tmp_path, monkeypatch):
    def refused(*_):
        raise why

    for name, does in (
        ("load_models", lambda *_: {}),
        ("open_source", lambda *_: None),
        ("_observe", refused),
    ):
        monkeypatch.setattr(f"huepose_services.demo.run.{name}", does)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    with (tmp_path / "output").open("w") as output:  # nothing more is written to a closed terminal
        monkeypatch.setattr("sys.stdout", output)
        assert _code(["demo"]) != 0
    assert not list(tmp_path.glob("huepose-demo-*"))


def _code(words):
    try:
        return main(words)
    except OSError:
        return 1


def test_if_the_demo_fails_the_last_error_of_the_log_is_quoted():
    log = "10:00:00.000 info  tracker   ready\n10:00:01.000 error segmenter no memory\n  File x\n"
    assert _complaints(log) == "\n10:00:01.000 error segmenter no memory"
    assert _complaints("") == ""
    said = '{"time": 1.5, "level": "error", "worker": "segmenter", "text": "no memory"}'
    assert _complaints(f"{said.replace('error', 'info')}\n{said}\n") == f"\n{said}", "with HUEPOSE_LOG=json"


@pytest.mark.parametrize("segmenter", ["depth", "sam"])
def test_the_demo_switches_the_segmenter_by_one_word(segmenter, tmp_path):
    made = networks.sam_encoder(tmp_path / "encoder.onnx"), networks.sam_decoder(tmp_path / "decoder.onnx")
    sam = [str(path) for path in made] if segmenter == "sam" else ()
    text = yaml.safe_dump(pipeline(0, tmp_path / "bundles", (), segmenter, sam))
    config = parse(text, tmp_path / "pipeline.yaml")
    assert (config.detector.kind, config.segmenter.kind) == ("views", segmenter)
    deployed.check(config)

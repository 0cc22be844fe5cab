"""The demo with a segmenter of SAM whose answers are known."""

import pytest
import yaml

from huepose_services import networks as deployed
from huepose_services.demo.run import pipeline
from huepose_services.runtime.config import parse
from tests.perception import networks


@pytest.mark.parametrize("segmenter", ["depth", "sam"])
def test_the_demo_switches_the_segmenter_by_one_word(segmenter, tmp_path):
    made = networks.sam_encoder(tmp_path / "encoder.onnx"), networks.sam_decoder(tmp_path / "decoder.onnx")
    sam = [str(path) for path in made] if segmenter == "sam" else ()
    text = yaml.safe_dump(pipeline(0, tmp_path / "bundles", (), segmenter, sam))
    config = parse(text, tmp_path / "pipeline.yaml")
    assert (config.detector.kind, config.segmenter.kind) == ("colorpair", segmenter)
    deployed.check(config)

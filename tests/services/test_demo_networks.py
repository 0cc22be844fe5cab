"""The demo with networks: the detector in the package, and a segmenter of SAM whose answers are known."""

import json

import pytest
import yaml

from huepose.geometry import Box, Camera, RgbdFrame
from huepose.perception.sessions import digest
from huepose.scenes.shapes import demo_objects
from huepose.training.pictures import PictureRange, endless_pictures
from huepose_services import networks as deployed
from huepose_services.demo.run import Perception, pipeline
from huepose_services.networks import BUILTIN_DETECTOR
from huepose_services.runtime.config import parse
from tests.perception import networks

INPUT = (192, 256)


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sam")
    made = networks.sam_encoder(folder / "encoder.onnx"), networks.sam_decoder(folder / "decoder.onnx")
    return [str(path) for path in made]


@pytest.mark.parametrize("detector", ["colorpair", "yolo"])
@pytest.mark.parametrize("segmenter", ["depth", "sam"])
def test_the_demo_switches_detector_and_segmenter_by_one_word(detector, segmenter, files, tmp_path):
    perception = Perception(detector, segmenter, files if segmenter == "sam" else None)
    text = yaml.safe_dump(pipeline(0, tmp_path / "bundles", perception))
    config = parse(text, tmp_path / "pipeline.yaml")
    assert (config.detector.kind, config.segmenter.kind) == (detector, segmenter)
    deployed.check(config)


def test_so_does_pipeline_yaml_with_the_built_in_scene(tmp_path):
    detector, _ = deployed.yolo(parse("detector: {kind: yolo}", tmp_path / "pipeline.yaml"))
    assert detector.layout == "v8"


def test_the_detector_in_the_package_finds_the_built_in_objects(tmp_path):
    objects = demo_objects(0)
    detector, network = deployed.yolo(parse("detector: {kind: yolo}", tmp_path / "pipeline.yaml"))
    plain = PictureRange(others=(0, 1), distance_m=(0.5, 0.9), exposure=(-0.3, 0.3), blur_px=(0.5, 1.0))
    camera = Camera(245.0, 245.0, 127.5, 95.5, INPUT[1], INPUT[0])
    wanted = hits = 0
    things = {name: [mesh] for name, mesh in objects.items()}
    pictures = endless_pictures(things, INPUT, 5, 900, plain)
    for _ in range(12):
        picture = next(pictures)
        frame = RgbdFrame(picture.image, picture.image[..., 0].astype("float32"), camera)
        seen = detector.detect(frame, list(objects))
        for (x0, y0, x1, y1), label in zip(picture.corners, picture.classes, strict=True):
            box, name = Box(x0, y0, x1 - x0, y1 - y0), list(objects)[label]
            wanted += 1
            hits += any(d.object == name and d.box.iou(box) >= 0.5 for d in seen)
    assert wanted > 25
    assert hits / wanted > 0.5
    told = json.loads(BUILTIN_DETECTOR.with_suffix(".json").read_text())
    assert told["classes"] == list(objects)
    assert told["sha256"] == digest(network.path)
    assert BUILTIN_DETECTOR.stat().st_size < 2_000_000

"""A camera that is a Python file: the documentation's example, and the errors of wrong files."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from huepose.support.errors import InputError
from huepose_services.camera.live import CameraError, LiveSource
from huepose_services.camera.python import open_source
from huepose_services.runtime.config_file import load

PAGE = Path(__file__).parents[3] / "docs" / "cameras.md"


def source(folder: Path, text: str) -> LiveSource:
    (folder / "my_camera.py").write_text(text)
    return open_file(folder, "my_camera.py")


def open_file(folder: Path, name: str) -> LiveSource:
    (folder / "pipeline.yaml").write_text(
        f"camera: {{source: python, path: {name}}}\nworkers: [camera]\nbundles: bundles\n"
    )
    return open_source(load(folder / "pipeline.yaml"))


def test_the_camera_of_the_documentation_gives_images(tmp_path: Path) -> None:
    (text,) = re.findall(r"```python\n(# my_camera.py.*?)```", PAGE.read_text(), re.DOTALL)
    camera = source(tmp_path, text).open()
    one, two = camera.read(1.0), camera.read(1.0)
    assert one is not None
    assert two is not None
    assert (one.color.shape, one.depth.dtype, one.camera.width) == ((480, 640, 3), np.float32, 640)
    assert (one.number, two.number) == (1, 2)
    assert one.device_ns < two.device_ns <= two.arrived_ns


def test_arrays_that_are_reused_for_each_image_give_different_images(tmp_path: Path) -> None:
    text = """import numpy as np

from huepose import Camera, RgbdFrame

color, depth = np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32)


def frames():
    while True:
        color[:] += 1
        depth[:] += 1.0
        yield RgbdFrame(color, depth, Camera(60.0, 60.0, 31.5, 23.5, 64, 48))
"""
    camera = source(tmp_path, text).open()
    one, two = camera.read(1.0), camera.read(1.0)
    assert one is not None
    assert two is not None
    assert not two.shows_the_same(one)
    assert [(shot.color.max(), shot.depth.max()) for shot in (one, two)] == [(1, 2.0), (2, 3.0)]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("frames = 3", "no function frames"),
        ("\nimport nothing_at_all", "ModuleNotFoundError: .*'nothing_at_all', in my_camera.py, line 2;"),
        ("def frames(:", r"SyntaxError: invalid syntax \(my_camera.py, line 1\);"),
        ("import json\njson.loads('')", "JSONDecodeError: .*, in my_camera.py, line 2;"),
        ("import sys\nsys.exit('no camera')", "SystemExit: no camera, in my_camera.py, line 2;"),
    ],
)
def test_a_file_that_is_no_camera_is_refused(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(InputError, match=says):
        source(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("def frames():\n    return iter(())", "has ended"),
        ("def frames():\n    return 5", r"frames\(\) returned int: it has to yield"),
        ("def frames():\n    yield 3", "gave int"),
        ("def frames():\n    yield None", "gave NoneType"),
        ("def frames():\n    raise RuntimeError", r"RuntimeError, in my_camera\.py, line 2\."),
        ("def frames():\n    open('/none')\n    return 5", r"'/none', in my_camera\.py, line 2\."),
        ("def frames():\n    exit()\n    yield", r"SystemExit: None, in my_camera\.py, line 2\. frames"),
        ("def frames(device):\n    yield", r"missing 1 required positional argument: 'device'\.$"),
        (
            "from huepose.datasets.image_files import read_camera\n\n\n"
            "def frames():\n    read_camera('none.json')\n    yield",
            r"depth_scale_m, in \w+\.py, line 5\. frames",
        ),
    ],
)
def test_what_is_no_frame_is_a_camera_error(tmp_path: Path, text: str, says: str) -> None:
    with pytest.raises(CameraError, match=says):
        source(tmp_path, text).open().read(1.0)


def test_a_path_is_needed(tmp_path: Path) -> None:
    (tmp_path / "pipeline.yaml").write_text("camera: {source: python}\n")
    with pytest.raises(InputError, match="frames"):
        load(tmp_path / "pipeline.yaml")
    with pytest.raises(InputError, match="no such file"):
        open_file(tmp_path, "gone.py")

"""A scene in the layout of the BOP benchmark as a camera."""

from __future__ import annotations

from pathlib import Path

from huepose.datasets.bop import BopScene
from huepose.datasets.types import Scene
from huepose_services.runtime.config import Config


def open_source(config: Config) -> Scene:
    """The scene in the folder `camera.path`."""
    assert config.camera.path is not None  # the configuration was checked
    return BopScene(Path(config.camera.path))

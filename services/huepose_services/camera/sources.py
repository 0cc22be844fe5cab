"""Open the source of images that `camera.source` names: a data set's folder, or a module of this
package."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from huepose.datasets.bop import BopScene
from huepose.datasets.fast_ycb import FastYcbSequence, object_of
from huepose.datasets.rosbag import RosbagScene, Topics
from huepose.geometry.arrays import Float64
from huepose.model import load_models
from huepose_services.runtime.config import Config


def open_source(config: Config) -> Any:
    """The source of a checked configuration: a LiveSource for live cameras, else a Scene."""
    source = config.camera.source
    if source == "bop":
        return BopScene(Path(config.camera.path or ""))
    if source == "fast_ycb":
        return _sequence(config, Path(config.camera.path or ""))
    if source == "rosbag":
        camera = config.camera
        topics = Topics(camera.color_topic, camera.depth_topic, camera.info_topic)
        return RosbagScene(Path(camera.path or ""), topics)
    return import_module(f"huepose_services.camera.{source}").open_source(config)


def _sequence(config: Config, path: Path) -> FastYcbSequence:
    """A Fast-YCB sequence. Its labels need the frame offset of the object, which its reference model
    has."""
    offset: Float64 | None = None
    if config.camera.truth and config.bundles is not None:
        name = object_of(path)
        offset = load_models(config.bundles, [name])[name].frame_offset_m
    return FastYcbSequence(path, offset)

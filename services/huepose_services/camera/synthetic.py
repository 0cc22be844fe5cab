"""A scene that code draws as a camera: its loop, played for ever."""

from __future__ import annotations

from pathlib import Path

from huepose.model import load_models
from huepose.scenes.builtin import SyntheticScene
from huepose_services.runtime.config import Config


def open_source(config: Config) -> SyntheticScene:
    """The scene of `camera.seed`, computed first where it is not in the cache folder: with the objects of
    `bundles`, or without that, with its own. Raises InputError where they do not fit into one."""
    if config.bundles is None:
        return SyntheticScene(config.camera.seed)
    names = [item.name for item in config.objects] or None
    meshes = {name: model.mesh for name, model in load_models(Path(config.bundles), names).items()}
    return SyntheticScene(config.camera.seed, objects=meshes)

"""A scene that code draws as a camera: its loop, played for ever."""

from __future__ import annotations

from huepose.geometry import Mesh
from huepose.scenes.builtin import SyntheticScene, check_scene
from huepose_services import models
from huepose_services.runtime.config import Config


def open_source(config: Config) -> SyntheticScene:
    """The scene of `camera.seed`, computed first where it is not in the cache folder: with the objects of
    `bundles`, or without that, with its own. Raises InputError where they do not fit into one."""
    if config.bundles is None:
        return SyntheticScene(config.camera.seed)
    return SyntheticScene(config.camera.seed, objects=_meshes(config))


def check_source(config: Config) -> None:
    """Raises InputError where `open_source` does because its objects do not fit, without drawing anything."""
    if config.bundles is not None:
        check_scene(_meshes(config), config.camera.seed)


def _meshes(config: Config) -> dict[str, Mesh]:
    """Of the objects, by name: the same ones are the same scene, in whichever order they are listed."""
    return {name: model.mesh for name, model in sorted(models.load(config).items())}

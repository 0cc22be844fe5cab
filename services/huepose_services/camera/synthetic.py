"""The rendered scene as a camera: a closed loop, played for ever."""

from __future__ import annotations

from huepose.geometry import Mesh
from huepose.scenes.builtin import SyntheticScene, check_scene
from huepose_services import models
from huepose_services.runtime.config import Config


def open_source(config: Config) -> SyntheticScene:
    """The scene of `camera.seed`, with the objects of `bundles` or, without these, the built-in ones. It is
    rendered first if it is not in the cache folder. Raises InputError if the objects do not fit into one
    scene."""
    if config.bundles is None:
        return SyntheticScene(config.camera.seed)
    return SyntheticScene(config.camera.seed, objects=_meshes(config))


def check_source(config: Config) -> None:
    """Raises InputError if the objects do not fit into one scene, as `open_source` does, but renders
    nothing."""
    if config.bundles is not None:
        check_scene(_meshes(config), config.camera.seed)


def _meshes(config: Config) -> dict[str, Mesh]:
    """The meshes by name, sorted: the same objects give the same scene, in whatever order they are
    listed."""
    return {name: model.mesh for name, model in sorted(models.load(config).items())}

"""Checks before workers are started: the objects are there, the source opens, the ports are free."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.util import find_spec
from typing import TYPE_CHECKING

from huepose.support.errors import InputError
from huepose.support.words import listed
from huepose_services.runtime.config import Config
from huepose_services.runtime.run_folder import is_taken, make_folder
from huepose_services.runtime.running import port_taken
from huepose_services.runtime.threads import check_processors

if TYPE_CHECKING:
    from huepose.model import ReferenceModel

_PACKAGES = {"ros2": "rosbags", "viewer": "rerun"}
"""Workers, and the package of their extra that they import."""

_FOLDERS = ("bop", "fast_ycb")
"""Sources that are folders of images."""


def prepare(config: Config) -> None:
    """Check everything, and make what the built-in scene needs at its first use. Raises InputError."""
    check(config)
    check_ports(config)
    own_models = config.bundles is None and config.uses_models
    drawn = config.camera.source == "synthetic" and "camera" in config.workers
    if not own_models and not drawn:
        return
    from huepose.support.compiling import telling_of_compiling

    with telling_of_compiling():
        if own_models:
            from huepose_services.models import bundles_folder

            bundles_folder(config)
        if drawn:
            from huepose_services.camera.sources import open_source

            open_source(config)


def check(config: Config) -> None:
    """Check whether a configuration can be started, as far as that can be known before; changes nothing.

    Raises InputError, and ModuleNotFoundError if the extra of a worker is not installed."""
    from huepose_services import models

    for worker in config.workers:
        check_processors(config.cpus.get(worker, ()))
        if (package := _PACKAGES.get(worker)) is not None and find_spec(package) is None:
            raise ModuleNotFoundError(f"{worker} needs {package}", name=package)
    if config.bundles is None and config.objects:
        _check_builtin(config)
    elif config.bundles is not None and (config.objects or config.uses_models):
        # Once here: else each worker would report a missing or damaged model.
        known = models.load(config)
        if config.estimator.method != "full" and "estimator" in config.workers:
            _check_tables(config.estimator.method, known.values())
    if config.camera.source != "synthetic" and "camera" in config.workers:
        from huepose_services.camera.sources import open_source

        source = open_source(config)
        if config.camera.source in _FOLDERS:
            from huepose_services.convert import check_size

            # A fault of one image (no depth, 8 bits, a packed form) is mostly a fault of all.
            check_size(source.frame(source.image_ids[0]).camera)
    if config.network_workers:
        from huepose_services import networks

        # Once here: a damaged network must not be found only by a worker.
        networks.check(config)
    if "gateway" in config.workers:
        from huepose_services.gateway_door import check_door

        check_door(config.gateway)
    if config.hosts:
        from huepose_services.link import check_link

        check_link(config)


def gaps(config: Config) -> list[str]:
    """What is missing in a checked folder of images that is played here, in sentences."""
    if config.camera.source not in _FOLDERS or "camera" not in config.workers:
        return []
    from huepose_services.camera.sources import open_source

    sentences: list[str] = open_source(config).gaps()
    return sentences


def _check_tables(method: str, models: Iterable[ReferenceModel]) -> None:
    bare = [model.name for model in models if model.tables is None]
    if bare:
        raise InputError(
            "estimator.method",
            found=f"{method}, and no tables of the paper's method in the reference models of {listed(bare)}",
            expected="models with these tables",
            fix="Make them again with `huepose onboard` or `huepose onboard-bop` and --paper; the method "
            "full needs no tables.",
        )


def _check_builtin(config: Config) -> None:
    from huepose.scenes.builtin import builtin_objects

    known = builtin_objects(config.camera.seed)
    for item in config.objects:
        if item.name not in known:
            raise InputError(
                f"object '{item.name}'",
                found="no such object in the built-in scene",
                expected=f"one of {', '.join(sorted(known))}",
                fix="Correct the name, or set `bundles` to the folder of your own reference models.",
            )


def check_ports(config: Config) -> None:
    """Raises InputError if a port of a worker, or one that it opens to other programs, is taken."""
    folder = make_folder()
    for worker in config.workers:
        if is_taken(folder, config.port(worker)):
            raise port_taken(config, worker)
    if "gateway" in config.workers:
        from huepose_services.gateway_door import check_free

        check_free(config.gateway)
    if "uplink" in config.workers:
        from huepose_services.link import check_uplink_free

        check_uplink_free(config)
    if "viewer" in config.workers:
        from huepose_services.viewer_ports import check_ports_free

        check_ports_free(config.viewer)

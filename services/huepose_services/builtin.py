"""The reference models of the built-in scene, made at first use and kept in the cache folder.

The folder's name is a digest of the meshes and of the code that makes models of them, so that a new version
never reads models of an old one. Folders that were not used for 30 days are deleted when the next one is
made; processes that have mapped their models keep them.
"""

from __future__ import annotations

import fcntl
import hashlib
import shutil
import sys
from contextlib import suppress
from functools import cache
from pathlib import Path

import huepose
from huepose.geometry.mesh import Mesh
from huepose.model.io import model_path, save_model
from huepose.scenes.builtin import builtin_objects
from huepose.support.files import cache_folder, writing
from huepose.support.kept import UNUSED_DAYS, unused
from huepose.support.progress import progress

_MAKERS = (
    "geometry",
    "rendering",
    "onboarding",
    "model",
    "colorpair",
    "propose/templates.py",
    "propose/features.py",
    "propose/keypoint_reference.py",
    "refine/point_to_plane.py",
    "refine/solver.py",
)
"""The code that makes models, below `huepose`: packages and modules."""

_LOCK = ".lock"


def builtin_names(seed: int) -> list[str]:
    """The names of the objects of the built-in scene."""
    return list(builtin_objects(seed))


def bundles_are_kept(seed: int) -> bool:
    """Whether the reference models of the built-in scene exist already."""
    meshes = builtin_objects(seed)
    return not _missing(_folder(meshes, paper=False), meshes)


@cache
def builtin_bundles(seed: int, paper: bool = False) -> Path:
    """The folder with the reference models of the built-in scene; missing ones are made first.

    paper: with the tables of the paper's method; these models have a folder of their own.

    Of several processes one makes the models, and the others wait for it."""
    meshes = builtin_objects(seed)
    folder = _folder(meshes, paper)
    if not _missing(folder, meshes):
        with suppress(OSError):
            (folder / _LOCK).touch()
        return folder
    with writing(folder, fix="Set XDG_CACHE_HOME to one that can."):
        folder.mkdir(parents=True, exist_ok=True)
        lock = (folder / _LOCK).open("w")
        for other in set(unused(folder.parent.iterdir(), UNUSED_DAYS)) - {folder}:
            shutil.rmtree(other, ignore_errors=True)
    with lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            print("waiting: another process onboards the built-in objects", file=sys.stderr, flush=True)
            fcntl.flock(lock, fcntl.LOCK_EX)
        missing = _missing(folder, meshes)
        if missing:
            from huepose.onboarding.reference import reference_model

            for name in progress(missing, "onboarding the built-in objects"):
                model = reference_model(meshes[name], name, paper=paper)
                save_model(model, model_path(folder, name))
    return folder


def _folder(meshes: dict[str, Mesh], paper: bool) -> Path:
    return cache_folder() / "builtin" / (_digest(meshes) + ("-paper" if paper else ""))


def _missing(folder: Path, meshes: dict[str, Mesh]) -> list[str]:
    """The objects whose reference models are not there yet."""
    return [name for name in meshes if not model_path(folder, name).exists()]


def _digest(meshes: dict[str, Mesh]) -> str:
    digest = hashlib.sha256()
    for name, mesh in meshes.items():
        digest.update(name.encode() + mesh.content())
    home = Path(huepose.__file__).parent
    for maker in _MAKERS:
        place = home / maker
        for source in sorted(place.glob("*.py")) if place.is_dir() else [place]:
            digest.update(source.read_bytes())
    return digest.hexdigest()[:16]

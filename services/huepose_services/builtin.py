"""The built-in scene: its reference models, made at first use and kept in the cache folder.

The folder's name is a digest of the meshes and of the code that makes models of them, so that a new version
never meets models of an old one.
"""

from __future__ import annotations

import hashlib
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from huepose.datasets.shapes import demo_objects
from huepose.datasets.synthetic_store import cache_folder
from huepose.geometry.mesh import Mesh
from huepose.model.io import model_path, save_model
from huepose.support.progress import progress

_MAKERS = ("colorpair", "geometry", "matching", "model", "onboarding", "rendering")


@cache
def builtin_bundles(seed: int) -> Path:
    """The folder with the reference models of the built-in scene; those that are missing are made."""
    meshes = demo_objects(seed)
    folder = cache_folder() / "builtin" / _digest(meshes)
    missing = [name for name in meshes if not model_path(folder, name).exists()]
    if missing:
        from huepose.onboarding import onboard_mesh

        for name in progress(missing, "learning the built-in objects"):
            save_model(onboard_mesh(meshes[name], name), model_path(folder, name))
    return folder


def _digest(meshes: dict[str, Mesh]) -> str:
    digest = hashlib.sha256()
    for name, mesh in meshes.items():
        digest.update(name.encode())
        for array in (mesh.vertices, mesh.faces, mesh.uv, mesh.texture):
            digest.update(array.tobytes())
    for room in _MAKERS:
        spec = find_spec(f"huepose.{room}")
        assert spec is not None
        for place in spec.submodule_search_locations or ():
            for source in sorted(Path(place).glob("*.py")):
                digest.update(source.read_bytes())
    return digest.hexdigest()[:16]

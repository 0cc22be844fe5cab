"""Point pair features (Drost et al. 2010) of OpenCV-contrib, in a separate process."""

from __future__ import annotations

import pickle
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
from open3d_rivals import model_cloud, scene_cloud, voxel_m
from rival import Seen

from huepose.geometry import se3
from huepose.geometry.arrays import Float64
from huepose.model import ReferenceModel
from huepose.support.errors import InputError

_MM = np.array([1000.0] * 3 + [1.0] * 3)
"""Factors of points and normals (6,): points from metres to millimetres; normals unchanged."""


class PointPairFeatures:
    """python: the interpreter of the environment made by `make_env.sh`."""

    def __init__(self, python: Path) -> None:
        if not python.exists():
            raise InputError(
                python,
                found="no such file",
                expected="the environment of OpenCV-contrib",
                fix="Run benchmarks/make_env.sh first.",
            )
        self._worker = subprocess.Popen(
            [python, Path(__file__).with_name("ppf_worker.py")], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )

    def prepare(self, model: ReferenceModel) -> None:
        """Train on the averaged surface samples."""
        self._ask("train", model.name, _oriented(model_cloud(model).voxel_down_sample(voxel_m(model) / 2)))

    def pose(self, model: ReferenceModel, seen: Seen) -> tuple[Float64, float, float] | None:
        """Match and refine."""
        scene = scene_cloud(seen, voxel_m(model) / 2)
        found, seconds = self._ask("pose", model.name, _oriented(scene))
        if found is None:
            return None
        T, residual = found
        T = np.array(T, np.float64)
        T[:3, 3] /= 1000.0
        if not np.isfinite(T).all() or abs(np.linalg.det(T[:3, :3])) < 0.5:
            return None
        return se3.orthonormalised(T), float(np.exp(-residual)), seconds

    def _ask(self, kind: str, name: str, points: Any) -> Any:
        assert self._worker.stdin is not None
        assert self._worker.stdout is not None
        pickle.dump((kind, name, points), self._worker.stdin)
        self._worker.stdin.flush()
        return pickle.load(self._worker.stdout)


def _oriented(cloud: Any) -> Any:
    both = np.concatenate([np.asarray(cloud.points), np.asarray(cloud.normals)], axis=1) * _MM
    return np.ascontiguousarray(both.astype(np.float32))

"""Votes for poses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from huepose.geometry.arrays import Float32, Int32


@dataclass(frozen=True, eq=False)
class Votes:
    """Many weak estimates of a pose, to be clustered.

    rotations (V, 3, 3) and translations (V, 3) float32 of T_cam_obj; weights (V,) float32; features (V,)
    int32: the scene feature of each vote, in ascending order, so that no feature counts twice.
    """

    rotations: Float32
    translations: Float32
    weights: Float32
    features: Int32

    def __len__(self) -> int:
        return len(self.weights)

    @staticmethod
    def empty() -> Votes:
        """No votes."""
        z = np.zeros
        f = np.float32
        return Votes(z((0, 3, 3), f), z((0, 3), f), z(0, f), z(0, np.int32))

    @staticmethod
    def joined(parts: list[Votes]) -> Votes:
        """The votes of several sources; each source keeps features of its own."""
        parts = [p for p in parts if len(p)]
        if not parts:
            return Votes.empty()
        first, features = 0, []
        for p in parts:
            features.append(p.features + np.int32(first))
            first += int(p.features[-1]) + 1
        return Votes(
            np.concatenate([p.rotations for p in parts]),
            np.concatenate([p.translations for p in parts]),
            np.concatenate([p.weights for p in parts]),
            np.concatenate(features).astype(np.int32),
        )

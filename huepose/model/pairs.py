"""The colour pairs of a reference model: the coarse ones, of large texture, and the fine ones."""

from __future__ import annotations

from huepose.colorpair.types import SurfacePairs
from huepose.model.types import PairReference


def reference_pairs(reference: PairReference) -> SurfacePairs:
    """The model's coarse pairs, in the object's frame."""
    n = int(reference.parameters["coarse_pairs"])
    return SurfacePairs(
        reference.points[:n], reference.normals[:n], reference.tangents[:n], reference.colors[:n]
    )


def fine_pairs(reference: PairReference, count: int) -> SurfacePairs:
    """At most `count` of the model's fine pairs, evenly spread over them, in the object's frame."""
    first = int(reference.parameters["coarse_pairs"])
    step = max(1, -(-(len(reference.points) - first) // count))
    rows = slice(first, None, step)
    return SurfacePairs(
        reference.points[rows], reference.normals[rows], reference.tangents[rows], reference.colors[rows]
    )

"""Offline: the tables of the paper's method, from the colour pairs of a model (paper, section III-C).

Side colours are clustered into semantic classes; each side's point enters the classified cloud, from which
the tables of triangles and of point pairs are built. The paper leaves open the number of classes and how to
find them (here at most eight, k-means in CIELAB), the spacing of the cloud (a fiftieth of the diameter), and
the weight of a point (from the number of views that show its pair, and its contrast).
"""

from __future__ import annotations

import numpy as np

from huepose.colorpair.types import SurfacePairs
from huepose.geometry.arrays import Int32
from huepose.model.types import PaperTables, ReferenceModel
from huepose.paper import ppf, triangles
from huepose.paper.cloud import ClassifiedCloud, color_classes, decoupled, nearest_class, sparse
from huepose.support.errors import InputError

SURE_VIEWS, SURE_CONTRAST = 3.0, 25.0
"""Number of views that show a pair, and its contrast in CIELAB units, from which on its weight is 1."""


CLASSES = 8
"""Largest number of semantic classes."""

SIDE_OFFSET, CLOUD_SPACING = 0.012, 0.02
"""Distance of the classified points from the edge, and smallest distance between points of one class, in
diameters."""


def build_tables(pairs: SurfacePairs, seen: Int32, diameter_m: float) -> PaperTables:
    """Classes, classified cloud, triangles and point pairs of a model.

    pairs: its coarse colour pairs (N), in the object's frame; seen (N,): number of views that show each.
    Without pairs all tables are empty. Deterministic.
    """
    if len(pairs):
        centers = color_classes(pairs.colors.reshape(-1, 3), CLASSES)
    else:
        centers = np.zeros((1, 3), np.float32)
    classes = nearest_class(pairs.colors, centers)
    share = np.minimum(seen / SURE_VIEWS, 1.0).astype(np.float32)
    contrast = np.linalg.norm(pairs.colors[:, 1] - pairs.colors[:, 0], axis=1)
    weights = share * np.minimum(contrast / SURE_CONTRAST, 1.0)
    offset_m = SIDE_OFFSET * diameter_m
    sides = np.stack([weights, weights], 1)
    cloud = decoupled(pairs.points, pairs.normals, pairs.tangents, classes, sides, offset_m)
    cloud = cloud[sparse(cloud, CLOUD_SPACING * diameter_m)]
    triangle_keys, corners = triangles.build_triangles(cloud, diameter_m)
    pair_keys, point_pairs, alpha = ppf.build_ppf(cloud, diameter_m)
    return PaperTables(
        centers=centers,
        side_classes=classes,
        cloud_points=cloud.points,
        cloud_normals=cloud.normals,
        cloud_classes=cloud.classes,
        cloud_weights=cloud.weights,
        triangle_keys=triangle_keys,
        triangles=corners,
        ppf_keys=pair_keys,
        ppf=point_pairs,
        ppf_alpha=alpha,
        parameters={
            "side_offset_m": offset_m,
            "triangle_bin_m": triangles.BIN * diameter_m,
            "ppf_bin_m": ppf.BIN * diameter_m,
        },
    )


def tables_of(model: ReferenceModel) -> PaperTables:
    """The tables of a model. Raises InputError for a model without them."""
    if model.tables is None:
        raise InputError(
            f"reference model '{model.name}'",
            found="no tables of the paper's method",
            expected="a model with classes, triangles and point pairs, for --method paper or colorpair",
            fix="Make it again with `huepose onboard` or `huepose onboard-bop` and --paper; "
            "--method full needs no tables.",
        )
    return model.tables


def reference_cloud(tables: PaperTables) -> ClassifiedCloud:
    """The model's classified cloud."""
    return ClassifiedCloud(
        tables.cloud_points, tables.cloud_normals, tables.cloud_classes, tables.cloud_weights
    )

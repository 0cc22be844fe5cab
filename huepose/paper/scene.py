"""Online: the classified point cloud of a scene (paper, section III-C).

Colour pairs of the object's region are extracted, lifted onto their surface and classified by the model's
pairs. The paper leaves open at which resolution pairs are compared: here the image is scaled to the
resolution of the model's views, so that both show the same texture.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.colorpair.extract import extract
from huepose.colorpair.types import ColorPairs, SurfacePairs
from huepose.geometry.arrays import Bool
from huepose.geometry.frame import RgbdFrame
from huepose.model.types import PairReference, ReferenceModel, reference_pairs
from huepose.paper.classes import classified
from huepose.paper.cloud import ClassifiedCloud
from huepose.paper.ppf import ppf_votes
from huepose.paper.tables import reference_cloud, tables_of

NEEDED_CLASSES, NEEDED_POINTS = 3, 30
"""Number of classes, and of visible points of each, that triangles need; with fewer, point pairs vote."""


def extract_at_model_scale(pairs: PairReference, frame: RgbdFrame, mask: Bool) -> ColorPairs:
    """Colour pairs of a mask (H, W), extracted at the same scale as the model's.

    Empty when no pixel of the mask has depth.
    """
    depths = frame.depth[mask & (frame.depth > 0)]
    if not len(depths):
        return ColorPairs.empty()
    scale = pairs.parameters["coarse_pixels_per_m"] * float(np.median(depths)) / frame.camera.fx
    return extract(frame.color, mask, scale=min(scale, 1.0))


def classified_scene(model: ReferenceModel, scene: SurfacePairs) -> ClassifiedCloud:
    """The classified cloud of a scene's lifted pairs, camera axes. Raises InputError for a model without the
    tables of the paper's method."""
    tables, reference = tables_of(model), reference_pairs(model.pairs)
    return classified(
        scene, reference, tables.side_classes, len(tables.centers), tables.parameters["side_offset_m"]
    )


def classes_in_sight(cloud: ClassifiedCloud) -> int:
    """Number of classes with enough points for triangles."""
    return int((np.bincount(cloud.classes, minlength=1) >= NEEDED_POINTS).sum())


def warm_up_point_pairs(models: Sequence[ReferenceModel]) -> None:
    """Compile the fallback, which most images do not need, on the cloud of the first model that has a table
    for it."""
    model = next((m for m in models if len(tables_of(m).ppf_keys)), None)
    if model is not None:
        tables = tables_of(model)
        ppf_votes(reference_cloud(tables), tables, model.diameter_m, np.random.default_rng(0))

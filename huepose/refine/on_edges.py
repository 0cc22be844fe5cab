"""The very last step: the print of the pose is laid on the image's edges, within the mask of what it shows.

Depth leaves open how a face lies along itself, and the dense score sees print through a smoothing of a
millimetre; edges are found to a fraction of a pixel (`refine.image_edges`). Without enough edges that
match the model's in place, direction and contrast, the pose stays as it is.
"""

from __future__ import annotations

import threading
from weakref import WeakKeyDictionary

import numpy as np

from huepose.colorpair.extract import extract
from huepose.geometry.arrays import Bool, Float64
from huepose.geometry.frame import RgbdFrame
from huepose.model.pairs import fine_pairs
from huepose.model.types import PairReference, ReferenceModel
from huepose.refine.image_edges import PrintEdges, edge_icp, image_edges, print_edges

PAIRS = 800
"""Of the model, those that a view shows among them."""


def laid_on_edges(model: ReferenceModel, frame: RgbdFrame, mask: Bool, T_cam_obj: Float64) -> Float64:
    """The pose (4, 4) after its print was laid on the edges inside the mask (H, W)."""
    printed = _printed(model.pairs)
    depths = frame.depth[mask]
    depths = depths[depths > 0]
    if not len(printed.points) or not len(depths):
        return T_cam_obj
    scale = model.pairs.parameters["fine_pixels_per_m"] * float(np.median(depths)) / frame.camera.fx
    edges = image_edges(extract(frame.color, mask, scale=min(scale, 1.0)))
    return edge_icp(printed, model.surface, edges, frame.depth, frame.camera, T_cam_obj).T_cam_obj


_known: WeakKeyDictionary[PairReference, PrintEdges] = WeakKeyDictionary()
_lock = threading.Lock()


def _printed(reference: PairReference) -> PrintEdges:
    """The edges of a model's print, made once for each model."""
    with _lock:
        found = _known.get(reference)
        if found is None:
            found = _known[reference] = print_edges(fine_pairs(reference, PAIRS))
        return found

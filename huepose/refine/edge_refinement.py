"""The very last step: the texture of the pose is laid on the image's edges, within the mask of what it shows.

Depth leaves open how a face lies along itself, and the dense score sees texture through a smoothing of a
millimetre; edges are found to a fraction of a pixel. Two factors, `edges` and `depth_samples`, enter one
system, from a wide gate to a narrow one. Without enough edges that match the model's in place, direction and
contrast, the pose stays as it is.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np

from huepose.colorpair.extract import extract
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float32, Float64
from huepose.geometry.camera import Camera
from huepose.geometry.frame import RgbdFrame
from huepose.model.pairs import fine_pairs
from huepose.model.types import PairReference, ReferenceModel, Surface
from huepose.refine.depth_samples import (
    DepthImage,
    DepthSamples,
    add_depth_samples,
    depth_image,
    depth_samples,
)
from huepose.refine.edges import (
    EdgeLimits,
    ImageEdges,
    ModelEdges,
    add_edges,
    edge_cells,
    image_edges,
    model_edges,
)
from huepose.refine.solver import DAMPING, FEWEST_FOR_A_STEP, Body, advance, clear, normal_equations
from huepose.support.jit import jit

PAIRS = 800
"""Of the model, those that a view shows among them."""


@dataclass(frozen=True)
class EdgeConfig:
    """gates_px: how far across the edge is looked, one iteration each; along_px: how far along it;
    min_cosine: of the directions of two edges; min_contrast: cosine of their contrasts; depth: weight of a
    depth residual against one of an edge, both in metres; gate_m: of depth residuals; samples: of the
    surface; fewest: edges that have to be matched for a pose to be moved."""

    gates_px: tuple[float, ...] = (5.0, 4.0, 3.0, 2.5, 2.0, 2.0, 1.5, 1.5)
    along_px: float = 3.0
    min_cosine: float = 0.9
    min_contrast: float = 0.8
    depth: float = 0.3
    gate_m: float = 0.006
    samples: int = 300
    fewest: int = 15


class _Factors(NamedTuple):
    """What pulls at a pose."""

    model: ModelEdges
    edges: ImageEdges
    limits: EdgeLimits
    image: DepthImage
    samples: DepthSamples


@dataclass(frozen=True, eq=False)
class EdgeAlignment:
    """T_cam_obj (4, 4); matched: edges in the last iteration, 0 when the pose was left alone; rms_px: their
    distance across the edge then."""

    T_cam_obj: Float64
    matched: int
    rms_px: float


def refine_on_edges(model: ReferenceModel, frame: RgbdFrame, mask: Bool, T_cam_obj: Float64) -> Float64:
    """The pose (4, 4) after its texture was laid on the edges inside the mask (H, W)."""
    textured = _edges_of(model.pairs)
    depths = frame.depth[mask]
    depths = depths[depths > 0]
    if not len(textured.points) or not len(depths):
        return T_cam_obj
    scale = model.pairs.parameters["fine_pixels_per_m"] * float(np.median(depths)) / frame.camera.fx
    edges = image_edges(extract(frame.color, mask, scale=min(scale, 1.0)))
    return align_edges(textured, model.surface, edges, frame.depth, frame.camera, T_cam_obj).T_cam_obj


def align_edges(
    model: ModelEdges,
    surface: Surface,
    edges: ImageEdges,
    depth: Float32,
    camera: Camera,
    T_cam_obj: Float,
    config: EdgeConfig | None = None,
) -> EdgeAlignment:
    """Move the object so that its texture lies on the image's edges and its surface on the depth.

    model: the edges of its texture; depth (h, w) metres, 0 = nothing, of the camera that saw the edges.
    The pose comes back unchanged where fewer than `fewest` edges match.
    """
    config = config or EdgeConfig()
    start = np.array(T_cam_obj, dtype=np.float64)
    if not len(model.points):
        return EdgeAlignment(start, 0, 0.0)
    T = start.copy()
    low, high = surface.points.min(0).astype(np.float64), surface.points.max(0).astype(np.float64)
    factors = _Factors(
        model,
        edges,
        EdgeLimits(config.along_px, config.min_cosine, config.min_contrast, config.gate_m),
        depth_image(depth, camera),
        depth_samples(surface, T, config.samples, config.depth),
    )
    body = Body(0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low)))
    matched, rms_px = _align(T, factors, body, np.array(config.gates_px))
    if matched < config.fewest:
        return EdgeAlignment(start, 0, 0.0)
    return EdgeAlignment(se3.orthonormalised(T), int(matched), float(rms_px))


@jit
def _align(T: Float64, factors: _Factors, body: Body, gates_px: Float64) -> tuple[int, float]:
    """Move the pose, one step a gate; edges matched in the last one, and the RMS of their pixels across."""
    image, limits = factors.image, factors.limits
    cells = edge_cells(factors.edges, image.depth.shape[0], image.depth.shape[1])
    equations = normal_equations(6)
    matched, rms_px = 0, 0.0
    for gate_px in gates_px:
        clear(equations)
        matched, weight, squares = add_edges(
            T, factors.model, factors.edges, cells, image, body, gate_px, limits, equations
        )
        rms_px = np.sqrt(squares / weight) if weight > 0.0 else 0.0
        if matched < FEWEST_FOR_A_STEP:
            break
        weight += add_depth_samples(T, factors.samples, image, body, limits.depth_m, equations)
        if advance(T, equations, body, DAMPING * weight) < 0.0:
            break
    return matched, rms_px


_known: WeakKeyDictionary[PairReference, ModelEdges] = WeakKeyDictionary()
_lock = threading.Lock()


def _edges_of(reference: PairReference) -> ModelEdges:
    """The edges of a model's texture, made once for each model."""
    with _lock:
        found = _known.get(reference)
        if found is None:
            found = _known[reference] = model_edges(fine_pairs(reference, PAIRS))
        return found

"""The paper's ablation: how filtering optical flow by colour pairs changes the motion that is computed from
it.

The relative pose between two frames some frames apart is computed without refinement, re-initialisation or
memory, from different choices of flow correspondences (paper, section IV, "Ablation Study"):

flow                 all flow on the object's surface, sampled evenly
flow filtered        of these, those whose two colours are still the same pair: the filter alone
consistent           of `flow`, what backward flow confirms and what ends on the propagated mask
consistent filtered  of these, those whose two colours are still the same pair: the filter alone
colorpair            as the paper's tracker: also points on the ridges of colour pairs, and weights

and by different estimators, each a `RelativePose`: `kabsch`, weighted least squares over all
correspondences; `robust`, RANSAC and reweighting; `residual`, a network that corrects the rotation of
`robust`; `direct`, a network that gives the whole rotation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import cv2
import numpy as np

from huepose.datasets.types import Sample, Scene
from huepose.evaluation.ablation_rows import GAP, AblationResult, AblationRow
from huepose.evaluation.targets import Targets, object_number
from huepose.geometry import kabsch, se3
from huepose.geometry.arrays import Bool, Float, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import NEAREST_M, Camera
from huepose.geometry.frame import RgbdFrame
from huepose.geometry.mesh import Mesh
from huepose.model.types import ReferenceModel
from huepose.paper.correspondences import MIN_SIMILARITY, Correspondences, match, side_color_similarity
from huepose.paper.relative_pose import LiftedMatches, RelativePose, lift_matches, robust_kabsch
from huepose.paper.rotation_network import learned
from huepose.propose.flow import Flow, compute
from huepose.rendering import render_depth
from huepose.support.errors import InputError
from huepose.support.progress import progress

LEAST_M, LEAST_RAD = 0.001, np.radians(1.0)
"""Least motion of a pair. Relative errors of smaller motions mean nothing: such pairs are left out and
counted."""

FLOW_STEP_PX = 4
"""Step of the grid of flow samples, the same for every choice."""

VISIBLE_M, VISIBLE_SHARE = 0.01, 0.005
"""Largest difference between measured and rendered depth at visible pixels: these metres plus this share of
the distance."""

WINDOW_GROWTH, WINDOW_PX = 0.3, 8.0
"""Flow is computed in the box around the object in both frames, grown by this share and these pixels."""


def plain_kabsch(matches: LiftedMatches) -> Float64 | None:
    """A RelativePose by weighted least squares over all matches, wrong ones included."""
    if len(matches) < kabsch.MIN_INLIERS or matches.weights.sum() <= 0.0:
        return None
    return kabsch.fit(matches.points_a, matches.points_b, matches.weights)


ESTIMATORS: Mapping[str, RelativePose] = {"kabsch": plain_kabsch, "robust": robust_kabsch}


def with_networks() -> dict[str, RelativePose]:
    """ESTIMATORS and the networks of the package."""
    return {**ESTIMATORS, "residual": learned("residual"), "direct": learned("direct")}


def evaluate_ablation(
    scenes: Sequence[Scene], targets: Targets, estimators: Mapping[str, RelativePose] | None = None
) -> AblationResult:
    """Compare all variants on every pair of frames of each sequence whose numbers differ by GAP, for every
    labelled object that is visible in both. The name of a variant is CHOICE/ESTIMATOR. Raises InputError if
    there is no such pair."""
    rows: list[AblationRow] = []
    left_out = pairs = 0
    for scene in scenes:
        known = set(scene.image_ids)
        firsts = [i for i in scene.image_ids if i + GAP in known]
        for image in progress(firsts, f"ablation {scene.name}"):
            for new in _pair(scene, image, targets, estimators or ESTIMATORS):
                pairs += 1
                left_out += not new
                rows += new
    if not rows:
        raise InputError(
            "ablation",
            found=f"{pairs} pairs of frames, {left_out} of them without motion",
            expected=f"an onboarded object that moves and is visible in frames {GAP} apart",
        )
    return AblationResult(rows, pairs, left_out)


def _pair(
    scene: Scene, image: int, targets: Targets, estimators: Mapping[str, RelativePose]
) -> list[list[AblationRow]]:
    """One list of rows for each object of a pair of frames; empty for an object that hardly moves."""
    before = {t.instance: t for t in scene.truths(image) if targets.wants(t) and t.visible}
    after = {t.instance: t for t in scene.truths(image + GAP) if t.visible}
    out: list[list[AblationRow]] = []
    samples: tuple[Sample, Sample] | None = None
    for instance, truth in before.items():
        later, model = after.get(instance), targets.model_of(truth)
        if later is None or model is None or truth.T_cam_obj is None or later.T_cam_obj is None:
            continue
        if not moves(truth.T_cam_obj, later.T_cam_obj):
            out.append([])
            continue
        samples = samples or (Sample.of(scene, image), Sample.of(scene, image + GAP))
        figures = compare(model, samples[0], samples[1], truth.T_cam_obj, later.T_cam_obj, estimators)
        number = object_number(model)
        out.append([AblationRow(scene.name, image, number, *figure) for figure in figures])
    return out


def moves(T_a: Float64, T_b: Float64) -> bool:
    """Whether an object moves and rotates enough for relative errors to be meaningful."""
    shift = float(np.linalg.norm(T_b[:3, 3] - T_a[:3, 3]))
    return shift >= LEAST_M and se3.rotation_angle(T_a, T_b) >= LEAST_RAD


def compare(
    model: ReferenceModel,
    a: Sample,
    b: Sample,
    T_a: Float64,
    T_b: Float64,
    estimators: Mapping[str, RelativePose],
) -> list[tuple[str, float | None, float | None, float | None, int]]:
    """(variant, relative rotation error, relative translation error, end-point error in px, matches) of
    every variant for an object that moves from pose T_a to T_b (4, 4). The relative errors are None if the
    estimator finds no motion, the end-point error if there is no match on the object."""
    camera = a.frame.camera
    boxes = [_box(model, T, camera) for T in (T_a, T_b)]
    flow = None
    if boxes[0] is not None and boxes[1] is not None:
        window = Box.around(boxes[0], boxes[1]).grown(WINDOW_GROWTH, WINDOW_PX)
        flow = compute(a.frame.color, b.frame.color, window, cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    if flow is None or boxes[0] is None:
        return [(f"{c}/{e}", None, None, None, 0) for c in CHOICES for e in estimators]
    mask = visible_within(model.mesh, T_a, a.frame, boxes[0])
    surface = render_depth(model.mesh, T_a, camera)
    true_motion = se3.compose(T_b, se3.inverse(T_a))
    out: list[tuple[str, float | None, float | None, float | None, int]] = []
    for choice in CHOICES:
        matches = chosen(choice, a, b, mask, flow)
        epe_px = endpoint_error_px(matches, surface, camera, true_motion)
        lifted = lift_matches(a.frame, b.frame, matches)
        for name, estimator in estimators.items():
            motion = estimator(lifted)
            rotation, translation = (None, None) if motion is None else errors(motion, T_a, T_b)
            out.append((f"{choice}/{name}", rotation, translation, epe_px, len(lifted)))
    return out


def visible_within(mesh: Mesh, T_cam_obj: Float64, frame: RgbdFrame, box: Box) -> Bool:
    """Pixels (H, W) in which the object is visible: it is rendered there, and measured depth confirms it.
    `box` bounds the object; it is clipped to the image."""
    mask = np.zeros(frame.depth.shape, bool)
    rows, columns = box.slices(frame.camera.width, frame.camera.height)
    w, h = columns.stop - columns.start, rows.stop - rows.start
    if w <= 0 or h <= 0:
        return mask
    rendered = render_depth(mesh, T_cam_obj, frame.camera.cropped(columns.start, rows.start, w, h))
    measured = frame.depth[rows, columns]
    near = np.abs(measured - rendered) < VISIBLE_M + VISIBLE_SHARE * rendered
    mask[rows, columns] = (rendered > 0) & (measured > 0) & near
    return mask


CHOICES = ("flow", "flow filtered", "consistent", "consistent filtered", "colorpair")


def chosen(choice: str, a: Sample, b: Sample, mask: Bool, flow: Flow) -> Correspondences:
    """The correspondences of a choice, see the module; `mask` (H, W): the object in the first frame."""
    colors = (a.frame.color, b.frame.color)
    if choice == "colorpair":
        return match(*colors, mask, flow, grid_step_px=FLOW_STEP_PX)
    if choice.startswith("consistent"):
        found = match(*colors, mask, flow, use_pairs=False, grid_step_px=FLOW_STEP_PX)
    else:
        found = _all_flow(mask, flow)
    if not choice.endswith("filtered"):
        return found
    return found[side_color_similarity(*colors, found.pixels_a, flow) >= MIN_SIMILARITY]


def _all_flow(mask: Bool, flow: Flow) -> Correspondences:
    rows, columns = np.nonzero(mask[::FLOW_STEP_PX, ::FLOW_STEP_PX])
    pixels = np.stack([columns, rows], 1).astype(np.float64) * FLOW_STEP_PX
    moved, _ = flow.at(pixels)
    ends = pixels + moved
    inside = (ends >= 0).all(1) & (ends <= np.array(mask.shape[::-1]) - 1).all(1)
    return Correspondences(pixels[inside], ends[inside], np.ones(int(inside.sum())))


def errors(T_b_a: Float64, T_a: Float64, T_b: Float64) -> tuple[float, float]:
    """Rotation and translation error of a motion, each as a share of the true motion."""
    moved = se3.compose(T_b_a, T_a)
    shift = np.linalg.norm(moved[:3, 3] - T_b[:3, 3]) / np.linalg.norm(T_b[:3, 3] - T_a[:3, 3])
    return se3.rotation_angle(moved, T_b) / se3.rotation_angle(T_a, T_b), float(shift)


def endpoint_error_px(
    matches: Correspondences, surface_depth: Float, camera: Camera, T_b_a: Float64
) -> float | None:
    """Mean distance in pixels between the end points of matches and the true end points, to which the true
    motion takes the surface points at their start. surface_depth (H, W): rendered depth of the object alone
    at its true pose, 0 elsewhere."""
    columns, rows = np.rint(matches.pixels_a).astype(int).T
    depth = surface_depth[rows, columns]
    on = depth > 0
    if not on.any():
        return None
    points = camera.backproject(matches.pixels_a[on], depth[on])
    ends = camera.project(se3.apply(T_b_a, points))
    return float(np.linalg.norm(ends - matches.pixels_b[on], axis=1).mean())


def _box(model: ReferenceModel, T_cam_obj: Float64, camera: Camera) -> Box | None:
    points = se3.apply(T_cam_obj, model.eval_points)
    if points[:, 2].min() < NEAREST_M:
        return None
    uv = camera.project(points)
    (x, y), (x1, y1) = uv.min(0), uv.max(0)
    return Box(float(x), float(y), float(x1 - x), float(y1 - y))

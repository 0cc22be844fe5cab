"""Pictures of `huepose estimate`: the poses drawn on the image, and for `--explain` how each came about."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np

from huepose.believe.state import State
from huepose.drawing.canvas import paragraph
from huepose.drawing.contact_sheet import contact_sheet
from huepose.drawing.overlay import STATE_COLOURS, Body, draw_poses
from huepose.estimation import PoseEstimate
from huepose.estimation.explanation import Explanation
from huepose.estimation.panels import LEGEND, Panels
from huepose.estimation.reasons import displacement, reasons
from huepose.geometry import Box, RgbdFrame
from huepose.geometry.arrays import Bool, Float64, UInt8
from huepose.judge.terms import score
from huepose.model import ReferenceModel
from huepose.propose.templates import table_of
from huepose.propose.views import retrieve
from huepose.rendering.render import render
from huepose.select.near_ties import TERMS
from huepose.support.files import write_picture, write_text

COLORS = ((70, 160, 255), (255, 80, 160), (60, 220, 220), (180, 110, 255), (240, 240, 240))
"""Colours of the places that were tried, most probable first. None of them is a colour of a state."""

REJECTED = (255, 90, 60)
"""Colour of a pose that was not accepted."""

VIEWS = 12
POSES = 3
SURE = "nothing speaks against this answer"


def draw_answers(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: Sequence[PoseEstimate]
) -> UInt8:
    """The colour image (H, W, 3) with outline, axes, name, state and quality of every pose, in the colour of
    its state."""
    bodies = [
        Body(
            models[a.object].mesh,
            a.T_cam_obj,
            STATE_COLOURS[a.state],
            f"{a.object} {a.state} {a.quality:.2f}",
        )
        for a in answers
        if a.T_cam_obj is not None
    ]
    return draw_poses(frame.color, frame.camera, bodies)


def draw_places(
    frame: RgbdFrame, model: ReferenceModel, why: str, places: Sequence[tuple[Float64, float, str]]
) -> UInt8:
    """A page (H, W, 3) about an object that was not found: why, and the poses at the places that were tried.

    places, most probable first: T_cam_obj (4, 4), the presence of the object there, and what speaks most
    against it."""
    bodies, lines = [], [f"{model.name} was not found. {why}"]
    for k, (T_cam_obj, chance, doubt) in enumerate(places):
        label = f"place {k + 1}: {chance:.2f}"
        bodies.append(Body(model.mesh, T_cam_obj, COLORS[k % len(COLORS)], label))
        lines.append(f"place {k + 1}: there with a probability of {chance:.2f}; {doubt}")
    picture = draw_poses(frame.color, frame.camera, bodies)
    return np.vstack([paragraph("\n".join(lines), picture.shape[1]), picture])


def write_explanation(
    folder: Path,
    name: str,
    frame: RgbdFrame,
    model: ReferenceModel,
    answer: PoseEstimate,
    explanation: Explanation,
    accepted: bool,
    reason: str,
) -> list[str]:
    """Write NAME_why.png, NAME_masks.png, NAME_views.png, NAME_pose.png and NAME_scores.json of an estimate;
    returns what speaks against it. accepted: it is given as the answer; reason: why not, or why `SUSPECT`."""
    doubts = reasons(model, answer, explanation)
    state = f"{answer.state}, quality {answer.quality:.2f}. " if accepted else "not found. "
    said = [f"{model.name}: {state}{reason}", *doubts, LEGEND]
    if accepted and not reason and not doubts:
        said.insert(1, SURE)
    write_picture(folder / f"{name}_why.png", _page(frame, model, answer, explanation, said))
    masks = [_tinted(frame, mask) for mask in explanation.masks]
    labels = [f"mask {k + 1}: {int(m.sum())} px" for k, m in enumerate(explanation.masks)]
    if answer.mask is not None:
        masks.append(_tinted(frame, answer.mask))
        labels.append("of the pose")
    rows, columns = explanation.box.grown(0.3, 10).slices(frame.camera.width, frame.camera.height)
    cut = [m[rows, columns] for m in masks if m[rows, columns].size]
    if cut:
        write_picture(folder / f"{name}_masks.png", contact_sheet(cut, 4, labels[: len(cut)]))
    _write_views(folder / f"{name}_views.png", model, explanation)
    write_picture(folder / f"{name}_pose.png", _drawn(frame, model, answer, accepted))
    evidence, ranked = explanation.evidence, explanation.ranked
    poses = [
        {"T_cam_obj": T.tolist(), "behind": float(behind), "terms": asdict(score(model, evidence.region, T))}
        for T, behind in zip(ranked.poses, ranked.behind, strict=True)
        if evidence is not None
    ]
    given = answer.state if accepted else State.LOST
    record = {"quality": answer.quality, "state": given, "doubts": doubts, "poses": poses}
    if reason:
        record["reason"] = reason
    held = explanation.contest
    if held is not None:
        record["contest"] = [
            {"T_cam_obj": T.tolist(), **dict(zip(TERMS, terms.tolist(), strict=True)), "weighed": float(sum_)}
            for T, terms, sum_ in zip(held.poses, held.terms, held.weighed(), strict=True)
        ]
    write_text(folder / f"{name}_scores.json", json.dumps(record, indent=2) + "\n")
    return doubts


def _drawn(frame: RgbdFrame, model: ReferenceModel, answer: PoseEstimate, accepted: bool) -> UInt8:
    if accepted or answer.T_cam_obj is None:
        return draw_answers(frame, {model.name: model}, [answer])
    body = Body(model.mesh, answer.T_cam_obj, REJECTED, f"{model.name}: not found")
    return draw_poses(frame.color, frame.camera, [body])


def _page(
    frame: RgbdFrame,
    model: ReferenceModel,
    answer: PoseEstimate,
    explanation: Explanation,
    said: Sequence[str],
) -> UInt8:
    """A page: the text `said`, then what the estimator saw, and where its best poses agree with it."""
    evidence, ranked = explanation.evidence, explanation.ranked
    poses = ranked.poses
    tolerance = 0.01 if evidence is None else evidence.region.tolerance_m
    own = [] if answer.mask is None else [answer.mask]
    panels = Panels.around(frame, explanation.box, own, tolerance)
    pictures = [panels.photo(explanation.box), panels.depth()]
    pictures.append(panels.masks(explanation.masks[0] if explanation.masks else None, answer.mask))
    labels = [model.name, "depth", f"first of {len(explanation.masks)} masks, the pose's outline"]
    for k, (T, total) in enumerate(zip(poses[:POSES], ranked.totals[:POSES], strict=True)):
        pictures += [panels.worn(model, T), panels.judged(model, T)]
        note = "the best" if k == 0 else displacement(model, T, poses[0])
        labels += [f"pose {k + 1}: {note}", f"pose {k + 1}: {total:.2f}"]
    sheet = contact_sheet(pictures, 3 if len(pictures) < 4 else 5, labels)
    return np.vstack([paragraph("\n".join(said), sheet.shape[1]), sheet])


def _write_views(path: Path, model: ReferenceModel, explanation: Explanation) -> None:
    """Write the retrieved views, beside the crop that they were compared with."""
    evidence = explanation.evidence
    if evidence is None:
        return
    crop, bounds = evidence.region.crop, evidence.region.bounds
    views = retrieve(table_of(model), crop, bounds, evidence.sources, VIEWS)
    x0, y0, x1, y1 = (float(x) for x in bounds)
    around = Box(x0, y0, x1 - x0, y1 - y0).grown(0.3, 5)
    rows, columns = around.slices(crop.camera.width, crop.camera.height)
    pictures = [crop.color[rows, columns]]
    pictures += [render([(model.mesh, T)], crop.camera).color[rows, columns] for T in views.poses]
    of = [f"mask {k + 1}" if k < len(explanation.masks) else "the box" for k in views.masks]
    labels = [f"{score:.2f}, {source}" for score, source in zip(views.scores, of, strict=True)]
    write_picture(path, contact_sheet(pictures, 5, ["seen", *labels]))


def _tinted(frame: RgbdFrame, mask: Bool) -> UInt8:
    """The image, darkened outside of a mask."""
    return np.where(mask[..., None], frame.color, frame.color // 4).astype(np.uint8)

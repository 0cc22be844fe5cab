"""What colour pairs give in the full method, place by place, all on the same masks, views and boxes.

Every object is looked at alone (poses do not compete), so that one place differs from the method as it ships
by nothing but what it does: the views, their registration and search are made once for an object, and each
place goes on from them. CPU time is that of the calling thread; what a place shares with the others counts
for it, too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from huepose.colorpair.denoise import to_lab
from huepose.colorpair.light import relit
from huepose.estimation.config import FullPathConfig
from huepose.estimation.full_path import estimate_full, finish, refine_coarse
from huepose.evaluation.colorpairs.place_answers import Found, Shared
from huepose.geometry.arrays import Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.judge.pair_terms import pair_score_many
from huepose.paper.colorpair import estimate_by_pairs, proposed_by_pairs
from huepose.paper.config import ColorpairPathConfig
from huepose.paper.hypotheses import HypothesesConfig, Reading, extract_at_model_scale, read_scene
from huepose.paper.pair_search import search_pairs
from huepose.paper.semantic_icp import ClassifiedScene, semantic_icp_many
from huepose.select.config import NearTieWeights
from huepose.support.stages import listening

SHIPPED = "as shipped"
"""The place that is none: the full method as it is."""

CHEAP_PAIRS, CHEAP_SAMPLES = 150, 100
JUDGED = (0.0, 0.25, 1.0)
"""Weights of the pairs' colours where poses nearly tie, other than the one in use."""

REFINED = 3
"""So many of the best poses are refined once more."""

LEAN = ColorpairPathConfig(refined=8, kept=3, semantic=False)
LEAN_SEARCH = FullPathConfig(kept=3, turned=2, searched=6)
NO_MORE = np.zeros((0, 4, 4))


@dataclass(frozen=True, eq=False)
class Answer:
    """What a place finds. poses (K, 4, 4), totals (K,): different ones, best first; seconds: CPU time until
    then, masks included; weight: of the pairs' colours where poses nearly tie; edges: whether the print's
    edges have the last word; method: whose quality they get."""

    poses: Float64
    totals: Float64
    seconds: float
    weight: float = NearTieWeights().pairs
    edges: bool = True
    method: str = "full"


Place = Callable[[Shared], dict[str, Answer]]


def places_of(shared: Shared, wanted: Sequence[str] | None = None) -> dict[str, Answer]:
    """The answers of all places by name, or of some kinds of them (keys of PLACES); first the full method as
    it is."""
    out = {SHIPPED: Answer(*shared.found, shared.spent("before", "full"))}
    for kind, place in PLACES.items():
        if wanted is None or kind in wanted:
            out.update(place(shared))
    return out


def _judgement(shared: Shared) -> dict[str, Answer]:
    """Poses that nearly tie are told apart with another weight of the pairs' colours, or none."""
    shipped = Answer(*shared.found, shared.spent("before", "full"))
    return {f"judgement at {w:g}" if w else "no judgement": replace(shipped, weight=w) for w in JUDGED}


def _hypotheses(shared: Shared) -> dict[str, Answer]:
    """Pairs propose poses beside the views: always, few of them, or in doubt; there also more views."""
    out = {}
    begun = shared.spent("before", "full") - shared.spent("finish")
    shipped = Answer(*shared.found, shared.spent("before", "full"))
    for name, kind in (("hypotheses", "whole"), ("few hypotheses", "lean")):
        found = _with_proposals(shared, kind)
        more = shared.spent("picture", f"{kind} proposed", f"{kind} finished")
        out[f"{name}, always"] = Answer(*found, begun + more)
        asked = Answer(*found, shared.spent("before", "full", "doubt") + more)
        out[f"{name}, in doubt"] = asked if shared.in_doubt else shipped
    out["three times the views, in doubt"] = shipped
    if shared.in_doubt:
        views = shared.config.retrieval
        config = replace(shared.config, retrieval=replace(views, views=3 * views.views))
        with shared.timed("more views"):
            poses, totals, _, _ = estimate_full(shared.model, shared.table, shared.evidence, config, NO_MORE)
        spent = shared.spent("before", "full", "doubt", "more views")
        out["three times the views, in doubt"] = Answer(poses, totals, spent)
    return out


def _with_proposals(shared: Shared, kind: str) -> Found:
    rng = np.random.default_rng(shared.seed)
    evidence, config, search = shared.evidence, ColorpairPathConfig(), shared.config
    if kind == "lean":
        config, search = LEAN, LEAN_SEARCH
        kept = max(len(evidence.sources) - 1, 1)  # without the whole box, which comes last
        evidence = replace(evidence, sources=evidence.sources[:kept], points_cam=evidence.points_cam[:kept])
    with shared.timed(f"{kind} proposed"):
        poses = proposed_by_pairs(shared.model, evidence, shared.picture, config, rng)
        poses = refine_coarse(shared.model, evidence.region, poses, search)
    return shared.finished(f"{kind} finished", poses)


def _verification(shared: Shared) -> dict[str, Answer]:
    """Which poses are worth a search: chosen by pairs instead of dense samples; half as many by either."""
    region, picture, model = shared.evidence.region, shared.picture, shared.model

    def by_pairs(poses: Float64) -> Float64:
        return pair_score_many(model, region, picture, poses, CHEAP_PAIRS, CHEAP_SAMPLES)[:, 0]

    out = {}
    half = replace(shared.config, searched=shared.config.searched // 2)
    with listening() as clock:
        refine_coarse(model, region, shared.trail.registered, shared.config)
    before = sum(cpu for _, cpu in clock.totals().values())
    rates: list[tuple[str, FullPathConfig, Callable[[Float64], Float64] | None]] = [
        ("first verification by pairs", shared.config, by_pairs),
        ("first verification by pairs, half searched", half, by_pairs),
        ("first verification dense, half searched", half, None),
    ]
    for name, config, rate in rates:
        with shared.timed(name):
            searched = refine_coarse(model, region, shared.trail.registered, config, rate)
            found = finish(model, region, searched, config)
        spent = shared.spent("before", "full", name) - before - shared.spent("finish")
        out[name] = Answer(*found, spent + (shared.spent("picture") if rate else 0.0))
    return out


def _refinement(shared: Shared) -> dict[str, Answer]:
    """The best poses refined once more, by a search on pairs or by semantic ICP, judged with the others."""
    region, best = shared.evidence.region, shared.found[0][:REFINED]
    begun = shared.spent("before", "full") - shared.spent("finish")
    with shared.timed("searched"):
        poses, _ = search_pairs(shared.model, region, shared.picture, best, (3.0, 1.5, 0.7), 600, 300)
    searched = shared.finished("searched finished", poses)
    with shared.timed("slid"):
        readings = _readings(shared)
        slid = NO_MORE
        if readings and len(best):
            cloud = readings[0].cloud
            scene = ClassifiedScene(cloud.points, cloud.classes, cloud.weights)
            fits = semantic_icp_many(shared.model.pairs, scene, best)
            slid = np.array([fit.T_cam_obj for fit in fits])
    classes = shared.finished("slid finished", slid)
    return {
        "refinement by search on pairs": Answer(
            *searched, begun + shared.spent("picture", "searched", "searched finished")
        ),
        "refinement by semantic ICP": Answer(*classes, begun + shared.spent("slid", "slid finished")),
    }


def _light(shared: Shared) -> dict[str, Answer]:
    """The light that pairs tell is taken out of the picture in which views are sought."""
    evidence, name = shared.evidence, "light of pairs, in the search for views"
    with shared.timed("light"):
        color = _in_the_models_light(shared)
    if color is None:
        return {name: Answer(*shared.found, shared.spent("before", "full", "light"))}
    relit_evidence = replace(evidence, picture=replace(evidence.picture, color=color))
    with shared.timed("relit"):
        poses, totals, _, _ = estimate_full(
            shared.model, shared.table, relit_evidence, shared.config, NO_MORE
        )
    return {name: Answer(poses, totals, shared.spent("before", "light", "relit"))}


def _readings(shared: Shared) -> list[Reading]:
    """The pairs of the believed mask under each light that could be, best first."""
    picture, mask = shared.evidence.picture, shared.evidence.region.mask
    frame = RgbdFrame(
        np.ascontiguousarray(picture.color), np.ascontiguousarray(picture.depth), picture.camera
    )
    pairs = extract_at_model_scale(shared.model.pairs, frame, mask)
    rng = np.random.default_rng(shared.seed)
    return read_scene(shared.model, pairs, frame, mask, HypothesesConfig(), rng)


def _in_the_models_light(shared: Shared) -> UInt8 | None:
    """The picture (h, w, 3) under the model's light; None where pairs tell none."""
    readings = _readings(shared)
    if not readings:
        return None
    lab = relit(to_lab(np.ascontiguousarray(shared.evidence.picture.color)), 1.0 / readings[0].light)
    color = np.asarray(cv2.cvtColor(lab, cv2.COLOR_Lab2RGB), np.float32)
    return np.asarray(np.rint(255.0 * np.clip(color, 0.0, 1.0)), np.uint8)


def _ending(shared: Shared) -> dict[str, Answer]:
    """Depth has the last word; and the full method without any of its two places of pairs."""
    shipped = Answer(*shared.found, shared.spent("before", "full"))
    without = replace(shipped, edges=False)
    return {"no edges in the end": without, "no pairs at all": replace(without, weight=0.0)}


def _alone(shared: Shared) -> dict[str, Answer]:
    """The other method, which has no views and no dense colour."""
    rng = np.random.default_rng(shared.seed)
    with shared.timed("alone"):
        found = estimate_by_pairs(shared.model, shared.evidence, ColorpairPathConfig(), rng)
    poses = np.array([T for _, T in found]).reshape(-1, 4, 4)
    totals = np.array([total for total, _ in found])
    spent = shared.spent("before", "alone")
    return {"method colorpair": Answer(poses, totals, spent, method="colorpair")}


PLACES: Mapping[str, Place] = {
    "judgement": _judgement,
    "hypotheses": _hypotheses,
    "verification": _verification,
    "refinement": _refinement,
    "light": _light,
    "edges": _ending,
    "alone": _alone,
}
"""Kinds of places."""

"""What colour pairs give in the full method, place by place, all on the same masks, views and boxes.

Every object is looked at alone (poses do not compete), so that one place differs from the next by nothing
but what it does: the views, their registration and search are made once for an object, and each place goes
on from them. CPU time is that of the calling thread; what a place shares with the full method counts for it,
too.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from huepose.colorpair.denoise import to_lab
from huepose.colorpair.light import relit
from huepose.estimation.by_pairs_too import pair_colors
from huepose.estimation.colorpair_path import proposed_by_pairs
from huepose.estimation.config import ColorpairPathConfig, FullPathConfig
from huepose.estimation.evidence import Evidence
from huepose.estimation.full_path import Trail, estimate_full, finish, refine_coarse
from huepose.geometry.arrays import Float64, UInt8
from huepose.geometry.frame import RgbdFrame
from huepose.matching.hypotheses import (
    HypothesesConfig,
    extract_at_model_scale,
    read_scene,
)
from huepose.matching.template_table import TemplateTable
from huepose.model.types import ReferenceModel
from huepose.support.stages import StageClock, listening
from huepose.verification.pairs import PairPicture, pair_picture, pair_score_many
from huepose.verification.pairs_search import search_pairs

DOUBTFUL_MARGIN, DOUBTFUL_TRUST = 0.06, 0.6
"""A margin to the next pose, and a trust in the masks (how well they fit the box), under which there is
doubt."""

CHEAP_PAIRS, CHEAP_SAMPLES = 150, 100
JUDGED = (0.1, 0.2, 0.4)
"""Weights of the pairs' colours beside the dense score."""

FULL = "full"
"""The place that is none: the full method as it is."""

LEAN = ColorpairPathConfig(refined=8, kept=3, semantic=False)
LEAN_SEARCH = FullPathConfig(kept=3, turned=2, searched=6)

Found = tuple[Float64, Float64]
"""Different poses (K, 4, 4) and their totals (K,), best first."""


@dataclass(frozen=True, eq=False)
class Answer:
    """What a place finds; seconds: CPU time of the search, without masks and the last settling."""

    poses: Float64
    totals: Float64
    seconds: float


@dataclass(eq=False)
class Shared:
    """One object of one frame, and what all places start from; `seconds` are CPU time by step."""

    model: ReferenceModel
    table: TemplateTable
    evidence: Evidence
    config: FullPathConfig
    seed: tuple[int, ...]
    found: Found = field(init=False)
    trail: Trail = field(init=False)
    picture: PairPicture = field(init=False)
    seconds: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        with listening() as clock, self.timed("full"):
            poses, totals, self.trail = estimate_full(
                self.model, self.table, self.evidence, self.config, np.zeros((0, 4, 4))
            )
        self.found = poses, totals
        self.seconds["finish"] = _finish_seconds(clock)
        region = self.evidence.region
        with self.timed("picture"):
            self.picture = pair_picture(self.model, region.crop, region.median_depth_m)

    @contextmanager
    def timed(self, step: str) -> Iterator[None]:
        """Keep the CPU time of a step."""
        start = time.thread_time()
        yield
        self.seconds[step] = time.thread_time() - start

    def spent(self, *steps: str) -> float:
        """Seconds of some steps together."""
        return sum(self.seconds[step] for step in steps)

    @property
    def in_doubt(self) -> bool:
        """Whether the margin of the full method is small, or no mask fits the box."""
        totals = self.found[1]
        close = len(totals) > 1 and totals[0] - totals[1] < DOUBTFUL_MARGIN
        return close or not len(totals) or self.evidence.region.trust < DOUBTFUL_TRUST

    def finished(self, step: str, more: Float64) -> Found:
        """The full method's searched poses judged together with `more` (N, 4, 4)."""
        with self.timed(step):
            every = np.concatenate([self.trail.searched, more])
            return finish(self.model, self.evidence.region, every, self.config)


def places_of(shared: Shared) -> dict[str, Answer]:
    """The answers of all places, by name; the first is the full method as it is."""
    out = {FULL: Answer(*shared.found, shared.spent("full"))}
    for place in (_as_hypotheses, _as_verification, _as_refinement, _as_light, _as_judgement):
        out.update(place(shared, out))
    return out


def _as_hypotheses(shared: Shared, _: Mapping[str, Answer]) -> dict[str, Answer]:
    """Pairs propose poses beside the views: always, few of them, or in doubt; there also more views."""
    out = {}
    begun = shared.spent("full") - shared.spent("finish")
    whole, lean = _with_proposals(shared, "whole"), _with_proposals(shared, "lean")
    for name, found, step in (("hypotheses", whole, "whole"), ("few hypotheses", lean, "lean")):
        more = shared.spent("picture", f"{step} proposed", f"{step} finished")
        out[name] = Answer(*found, begun + more)
        out[f"{name} in doubt"] = (
            Answer(*found, shared.spent("full") + more)
            if shared.in_doubt
            else Answer(*shared.found, shared.spent("full"))
        )
    again, found = 0.0, shared.found
    if shared.in_doubt:
        config = replace(shared.config, retrieved=3 * shared.config.retrieved)
        with shared.timed("more views"):
            poses, totals, _trail = estimate_full(
                shared.model, shared.table, shared.evidence, config, np.zeros((0, 4, 4))
            )
        found = poses, totals
        again = shared.spent("more views")
    out["more views in doubt"] = Answer(found[0], found[1], shared.spent("full") + again)
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


def _as_verification(shared: Shared, _: Mapping[str, Answer]) -> dict[str, Answer]:
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
        ("verification", shared.config, by_pairs),
        ("verification, half searched", half, by_pairs),
        ("half searched", half, None),
    ]
    for name, config, rate in rates:
        with shared.timed(name):
            searched = refine_coarse(model, region, shared.trail.registered, config, rate)
            found = finish(model, region, searched, config)
        spent = shared.spent("full", name) - before - shared.spent("finish")
        out[name] = Answer(*found, spent + (shared.spent("picture") if rate else 0.0))
    return out


def _as_refinement(shared: Shared, _: Mapping[str, Answer]) -> dict[str, Answer]:
    """The best three are searched once more by pairs, and judged with the others."""
    region, best = shared.evidence.region, shared.found[0][:3]
    with shared.timed("refined"):
        poses, _totals = search_pairs(shared.model, region, shared.picture, best, (3.0, 1.5, 0.7), 600, 300)
    found = shared.finished("refined finished", np.concatenate([shared.found[0], poses]))
    begun = shared.spent("full") - shared.spent("finish")
    return {"refinement": Answer(*found, begun + shared.spent("picture", "refined", "refined finished"))}


def _as_light(shared: Shared, _: Mapping[str, Answer]) -> dict[str, Answer]:
    """The light that pairs tell is taken out of the picture in which views are sought."""
    evidence = shared.evidence
    with shared.timed("light"):
        color = _in_the_models_light(shared)
    if color is None:
        return {"light": Answer(*shared.found, shared.spent("full", "light"))}
    relit_evidence = replace(evidence, picture=replace(evidence.picture, color=color))
    with shared.timed("relit"):
        poses, totals, _trail = estimate_full(
            shared.model, shared.table, relit_evidence, shared.config, np.zeros((0, 4, 4))
        )
    return {"light": Answer(poses, totals, shared.spent("light", "relit"))}


def _in_the_models_light(shared: Shared) -> UInt8 | None:
    """The picture (h, w, 3) under the model's light; None where pairs tell none."""
    picture, mask = shared.evidence.picture, shared.evidence.region.mask
    frame = RgbdFrame(
        np.ascontiguousarray(picture.color), np.ascontiguousarray(picture.depth), picture.camera
    )
    pairs = extract_at_model_scale(shared.model.pairs, frame, mask)
    rng = np.random.default_rng(shared.seed)
    readings = read_scene(shared.model, pairs, frame, mask, HypothesesConfig(), rng)
    if not readings:
        return None
    lab = relit(to_lab(frame.color), 1.0 / readings[0].light)
    color = np.asarray(cv2.cvtColor(lab, cv2.COLOR_Lab2RGB), np.float32)
    return np.asarray(np.rint(255.0 * np.clip(color, 0.0, 1.0)), np.uint8)


def _as_judgement(shared: Shared, before: Mapping[str, Answer]) -> dict[str, Answer]:
    """The different poses in the end are put in order by the dense score and the pairs' colours together."""
    out = {}
    for place in (FULL, "few hypotheses"):
        answer = before[place]
        with shared.timed("judged"):
            colors = pair_colors(shared.model, shared.evidence.region, answer.poses)
        for weight in JUDGED:
            order = np.argsort(-(answer.totals + weight * colors), kind="stable")
            spent = answer.seconds + shared.spent("judged")
            name = f"judgement {weight:g}" if place == FULL else f"{place}, judgement {weight:g}"
            out[name] = Answer(answer.poses[order], answer.totals[order], spent)
    return out


def _finish_seconds(clock: StageClock) -> float:
    """CPU time of the last two steps of the full method: judging, and the fine search."""
    spans = clock.spans
    return sum(cpu for _, cpu in spans.get("judge", [])) + (
        spans["search"][-1][1] if len(spans.get("search", [])) > 1 else 0.0
    )

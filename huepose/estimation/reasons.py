"""Explain estimates in words, from measurements: why a pose is doubtful, and why none was found."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from huepose.believe.quality import QualityTerms, quality_fits
from huepose.estimation.config import Method
from huepose.estimation.explanation import Explanation
from huepose.estimation.types import ObjectQuery, PoseEstimate
from huepose.geometry import se3
from huepose.geometry.arrays import Bool, Float, Float64
from huepose.geometry.box import Box
from huepose.geometry.camera import Camera
from huepose.judge.terms import Terms, score
from huepose.model.types import ReferenceModel

CLOSE_MARGIN = 0.1
"""Totals closer than this are a near tie: light and noise change them by as much."""

MUCH_SEEN_THROUGH, MUCH_OCCLUDED, LITTLE_TEXTURE, LITTLE_BOX, LITTLE_MASK = 0.1, 0.4, 0.3, 0.5, 0.5
MUCH_WITHOUT_DEPTH = 0.3
"""Limits of shares of a pose, of its texture's correlation, and of overlaps. Beyond them they are evidence
against the pose."""

OTHER_ORIENTATION_RAD = np.radians(15.0)
"""A pose rotated by less does not count as another orientation."""

NO_PROBABILITY = "This method does not say how probable it is that a pose is right."


def only_orientation_in_doubt(answer: PoseEstimate, method: Method) -> bool:
    """Whether only other orientations that fit as well keep an estimate from being `TRACKING`: with their
    probabilities added to its own, it would be."""
    T = answer.T_cam_obj
    if T is None or not answer.alternatives:
        return False
    rotated = sum(
        p
        for other, p in answer.alternatives
        if se3.rotation_angle(other[:3, :3], T[:3, :3]) > OTHER_ORIENTATION_RAD
    )
    return answer.quality + rotated >= quality_fits()[method].level


def reasons(model: ReferenceModel, answer: PoseEstimate, explanation: Explanation) -> list[str]:
    """The evidence against an estimate, clearest first; empty if there is none."""
    evidence = explanation.evidence
    if evidence is None:
        return ["no depth in the box: nothing to look at"]
    if not len(explanation.ranked):
        return ["no view of the object was proposed"]
    terms = score(model, evidence.region, explanation.ranked.poses[0])
    out = [f"the best pose scores {terms.total:.2f} only: nothing like the object is here"]
    if answer.found:
        out = []
    return [*out, *_ties(model, explanation), *_of_masks(answer.mask, explanation.masks), *_of_terms(terms)]


def _ties(model: ReferenceModel, explanation: Explanation) -> list[str]:
    ranked = explanation.ranked
    return [
        f"a near tie: {displacement(model, T, ranked.poses[0])}, it is behind by {behind:.2f} only"
        for T, behind in zip(ranked.poses[1:3], ranked.behind[1:3], strict=True)
        if behind < CLOSE_MARGIN
    ]


def _of_masks(mask: Bool | None, masks: Sequence[Bool]) -> list[str]:
    """How badly the best candidate mask matches the pose's own pixels; empty if it matches well."""
    if mask is None or not masks or not mask.any():
        return []
    best = max(masks, key=lambda m: overlap(m, mask))
    if overlap(best, mask) >= LITTLE_MASK:
        return []
    return [f"the masks show something else: {covering(best, mask, 'the pose')}"]


def why_unseen(query: ObjectQuery, box: Box, camera: Camera) -> str:
    """Why there is nothing to look at for a query, in one sentence. box: where it was looked for; camera: of
    the frame."""
    if query.box is None and box.area == 0.0:
        where = "masks are empty" if query.masks else "prior is outside of the image"
    elif min(box.w, box.h) <= 0.0:
        where = f"box is empty ({box.w:g} x {box.h:g} pixels)"
    elif box.clipped(camera.width, camera.height).area == 0.0:
        where = f"box is outside of the image ({camera.width} x {camera.height} pixels)"
    else:
        return "There is no depth in the box, so there is nothing to look at."
    return f"The {where}, so there is nothing to look at."


def why_absent(terms: QualityTerms | None, chance: float, least: float) -> str:
    """Why no pose was found where there is depth, in one sentence. terms: of the best pose, if there is one;
    chance: probability that the object is there; least: the probability that is needed."""
    if terms is None:
        return "No view of the object resembles what is in the box."
    against = _of_terms(terms) or [f"the best pose scores {terms.total:.2f}"]
    likely = f"it is with a probability of {under(chance, least)}; {least:.2f} is needed"
    return f"The object is not in this box ({likely}): {', and '.join(against[:2])}."


def under(chance: float, least: float) -> str:
    """A probability that is less than another one, so that both differ in two decimals as well.

    >>> under(0.31, 0.6), under(0.598, 0.6)
    ('0.31', '0.59')
    """
    return f"{min(chance, least - 0.01):.2f}"


def _of_terms(terms: Terms | QualityTerms) -> list[str]:
    unknown = max(0.0, 1.0 - terms.seen - terms.occluded)
    said = (
        (
            terms.violation > MUCH_SEEN_THROUGH,
            f"depth shows what lies behind the object on {100 * terms.violation:.0f} % of the pose",
        ),
        (
            terms.occluded > MUCH_OCCLUDED,
            f"something is in front of {100 * terms.occluded:.0f} % of the pose",
        ),
        (
            unknown > MUCH_WITHOUT_DEPTH,
            f"{100 * unknown:.0f} % of the pose has no depth, or depth that does not fit",
        ),
        (terms.color < LITTLE_TEXTURE, f"the texture agrees little (correlation {terms.color:.2f})"),
        (terms.box_iou < LITTLE_BOX, f"the pose's bounds overlap the box by {terms.box_iou:.2f} only"),
    )
    return [text for holds, text in said if holds]


def displacement(model: ReferenceModel, T_cam_obj: Float, T_reference: Float) -> str:
    """The difference of two poses, in words: the rotation, the object's axis if it is about one, and the
    shift of the centre."""
    between = se3.compose(se3.inverse(np.asarray(T_reference)), np.asarray(T_cam_obj))
    angle = se3.rotation_angle(np.eye(3), between[:3, :3])
    shift = 1000 * float(np.linalg.norm(se3.apply(between, model.mesh.centre[None])[0] - model.mesh.centre))
    words = f"rotated {np.degrees(angle):.0f} deg"
    if angle > np.radians(10.0):
        words += _about(between[:3, :3])
    return f"{words}, shifted {shift:.0f} mm"


def _about(R: Float64) -> str:
    """The object's axis that a rotation is about, in words; empty if it is none."""
    values, vectors = np.linalg.eig(R)
    axis = np.abs(np.real(vectors[:, int(np.argmin(np.abs(values - 1.0)))]))
    k = int(np.argmax(axis))
    return f" about its {'xyz'[k]} axis" if axis[k] > 0.95 else ""


def covering(mask: Bool, of: Bool, name: str) -> str:
    """How a mask (H, W) covers another that is not empty, in words."""
    common = int((mask & of).sum())
    covered, own = common / int(of.sum()), common / max(int(mask.sum()), 1)
    return f"the best mask covers {100 * covered:.0f} % of {name}, which is {100 * own:.0f} % of the mask"


def overlap(one: Bool, other: Bool) -> float:
    """Intersection over union of two masks (H, W), 0 for empty ones."""
    either = int((one | other).sum())
    return int((one & other).sum()) / either if either else 0.0

"""Select the final poses of a frame among the estimates at proposed places.

A detector may propose places for objects that are not there, several places for one object, and one place for
several objects. A pose is kept if its object is present with sufficient probability, and if no more probable
pose explains the same depth: one surface, one pose.
"""

from __future__ import annotations

from collections.abc import Sequence

from huepose.estimation.reasons import under
from huepose.estimation.types import PoseEstimate
from huepose.geometry.image_faults import IF_IN_PLAIN_VIEW
from huepose.select.distinct import pixels, standing

PRESENT = 0.6
"""A pose is kept from this probability that its object is there. It gives one false positive in ten frames of
the rendered set `choose` of studies.presence (docs/detection_measured.md)."""


def accepted_answers(answers: Sequence[PoseEstimate]) -> list[PoseEstimate]:
    """The estimates that are kept, most probable first.

    Estimates without a pose are left out. One without a mask claims no pixels, so it conflicts with no
    other."""
    likely = [
        answer
        for answer in answers
        if answer.found and answer.chance >= PRESENT and (answer.mask is None or answer.mask.any())
    ]
    surfaces = [pixels(answer.mask) for answer in likely]
    return [likely[i] for i in standing(surfaces, [answer.chance for answer in likely])]


def why_none_accepted(
    name: str, answers: Sequence[PoseEstimate], doubts: Sequence[str] = (), advise: bool = True
) -> str:
    """Why no pose of an object is kept, in words: the reason of its most probable estimate, if it has any.

    answers: as for `accepted_answers`, of all objects of the frame; doubts: for each estimate, the strongest
    evidence against its object (`estimation.present`); advise: nothing else in the frame is sure, so the data
    of its camera may be wrong."""
    doubts = doubts or [""] * len(answers)
    mine = [x for x in zip(answers, doubts, strict=True) if x[0].object == name]
    if not mine:
        advice = f" {IF_IN_PLAIN_VIEW}" if advise else ""
        return f"The detector found no place in the frame that looks like the object.{advice}"
    best, doubt = max(mine, key=lambda item: item[0].chance)
    if not best.found:
        return best.reason
    places = "the only place" if len(mine) == 1 else f"the best of {len(mine)} places"
    if best.chance >= PRESENT:
        return f"Another object explains the surface at {places} better."
    likely = f"with a probability of {under(best.chance, PRESENT)}, which is under {PRESENT:.2f}"
    said = f"At {places} the object is there {likely}"
    return f"{said}: {doubt}." if doubt else f"{said}."

"""Whether the objects that are looked for are found in a camera's picture; if none is, what may be wrong."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from huepose.estimation import Estimator, ObjectQuery
from huepose.estimation.size_doubts import doubted_in
from huepose.estimation.size_doubts import said as size_said
from huepose.geometry import RgbdFrame
from huepose.model import ReferenceModel
from huepose.perception.colorpair_detector import ColorPairDetector
from huepose.perception.exchanged import PLAIN, order_of_channels
from huepose.profiles import profile
from huepose_services.doctor.finding import Finding

MOST = 5
"""Of the objects, so that an examination takes seconds with any number of them."""


def objects_in(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], aside: bool = False
) -> Iterator[Finding]:
    """What is found of the first objects, by name, and what their poses say of the camera. aside: whether
    depth does not lie on the colours."""
    names = sorted(models)[:MOST]
    live = profile("live")
    detector = ColorPairDetector({name: models[name] for name in names}, live.detector)
    seen = detector.detect(frame, names)
    places = [place for place in seen if place.score >= PLAIN]
    scores = dict.fromkeys(names, 0.0) | {place.object: place.score for place in seen[::-1]}
    why = order_of_channels(frame, detector, names, scores).exchanged
    if why:
        yield Finding("camera", "bad", "red and blue seem to be exchanged", why)
    if not places:
        yield Finding("objects", "none", f"none of {', '.join(names)} is in the last picture")
        return
    best = {place.object: place for place in places[::-1]}
    estimator = Estimator(models, live.estimator)
    answers = estimator.estimate(
        frame, [ObjectQuery(name, best[name].box, searched=True) for name in sorted(best)]
    )
    said = ", ".join(f"{answer.object} {answer.state} {answer.quality:.2f}" for answer in answers)
    size, doubted = doubted_in(frame, models, answers)
    if size:
        yield Finding("camera", "bad", "sizes do not fit", size.said(frame.camera))
    for k, of_object in doubted.items():
        yield Finding("objects", "bad", f"{answers[k].object} does not fit", size_said(of_object))
    if aside or size or why:
        yield Finding("objects", "note", said, "Seen, but not where these poses are: see what is BAD above.")
    else:
        yield Finding("objects", "ok", said)

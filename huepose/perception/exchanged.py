"""Detects images whose red and blue channels are exchanged, as in images that OpenCV reads.

A frame is searched once more with its first and last channel exchanged. An object that is clearly found
only then shows that they were exchanged; one that is clearly found only in the frame as it is shows that
the order is right."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from huepose.geometry.frame import RgbdFrame
from huepose.perception.types import Detection, Detector

PLAIN = 0.7
"""Least score of an object that is clearly there. Of 74 labels in 19 real and rendered frames 54 reach it,
and two, both a marker, in the frames with exchanged channels."""

LEAD = 0.3
"""Least lead of such a score over the score of the same object in the other order."""


class ChannelOrder(NamedTuple):
    """What a frame shows about the order of its channels. exchanged: a question to the user, empty if
    nothing speaks against the order; right: an object is found that is not found with red and blue
    exchanged."""

    exchanged: str = ""
    right: bool = False


def order_of_channels(
    frame: RgbdFrame, detector: Detector, names: Sequence[str], seen: Mapping[str, float] | None = None
) -> ChannelOrder:
    """The order of a frame's channels, by the named objects. Objects that look alike in both orders, such
    as a grey mug, show nothing. seen: scores of objects that have just been searched for in the frame; the
    others are searched for here."""
    other = replace(frame, color=np.ascontiguousarray(frame.color[:, :, ::-1]))
    exchanged, as_it_is = _scores(detector.detect(other, names)), dict(seen or {})
    # A short search may have missed an object that is clear in the other order.
    again = [name for name in names if name not in as_it_is or exchanged.get(name, 0.0) >= PLAIN]
    if again:
        as_it_is |= _scores(detector.detect(frame, again))
    leads = {
        name: exchanged.get(name, 0.0) - as_it_is.get(name, 0.0)
        for name in names
        if max(exchanged.get(name, 0.0), as_it_is.get(name, 0.0)) >= PLAIN
    }
    if min(leads.values(), default=0.0) <= -LEAD:
        return ChannelOrder(right=True)
    name = max(leads, key=lambda one: leads[one], default="")
    if leads.get(name, 0.0) < LEAD:
        return ChannelOrder()
    return ChannelOrder(
        f"With red and blue exchanged, {name} is found in the image: are its channels in the order "
        "blue, green, red? They have to be red, green, blue (cv2.cvtColor, COLOR_BGR2RGB)."
    )


def _scores(places: Sequence[Detection]) -> dict[str, float]:
    """The best score of each object."""
    return {place.object: place.score for place in sorted(places, key=lambda place: place.score)}

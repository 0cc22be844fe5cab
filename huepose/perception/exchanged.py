"""Are red and blue exchanged, as in pictures that OpenCV reads?

A picture is searched once more with its first and last channel exchanged: what is plainly in it then, and was
not before, says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from huepose.geometry.frame import RgbdFrame
from huepose.perception.types import Detector

PLAIN = 0.7
"""Least score of an object that is plainly there. Of 74 labels in 19 real and drawn frames 54 reach it, and
two, both a marker, in the pictures with exchanged channels."""

LEAD = 0.3
"""Least lead of such a score over that of the same object in the picture as it is."""


def channels_exchanged(frame: RgbdFrame, detector: Detector, names: Sequence[str]) -> str | None:
    """What to ask about a frame in which the named objects are looked for; None where nothing speaks against
    the order of its channels."""
    other = replace(frame, color=np.ascontiguousarray(frame.color[:, :, ::-1]))
    found = [place for place in detector.detect(other, names) if place.score >= PLAIN]
    as_it_is = detector.detect(frame, [found[0].object]) if found else []
    if not found or found[0].score < LEAD + max((place.score for place in as_it_is), default=0.0):
        return None
    return (
        f"With red and blue exchanged, {found[0].object} is in the picture: are its channels in the order "
        "blue, green, red? They have to be red, green, blue (cv2.cvtColor, COLOR_BGR2RGB)."
    )

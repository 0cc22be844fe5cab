"""Which frames of a sequence are fed, and when a slow estimator's results about them come back.

ROFT evaluates with perception at 5 Hz whose results are one period late (DatasetImageSegmentationDelayed.cpp:
at 30 Hz the result of frame i - 6 at every sixth frame). Here the same rule is stated in time, so that it
holds for skipped frames and uneven stamps.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from huepose.support.errors import InputError

PERIOD_NS = 200_000_000
_TOLERANCE_NS = 1_000_000


class Delivery(NamedTuple):
    """Result about the fed frame `looked_at`, delivered with the fed frame `delivered` (None: too late)."""

    looked_at: int
    delivered: int | None


def fed_images(image_ids: Sequence[int], every: int) -> tuple[int, ...]:
    """The images i with (i - first) mod `every` == 0. Raises InputError when `every` is under 1.

    >>> fed_images([3, 4, 5, 7, 8], 2)
    (3, 5, 7)
    """
    if every < 1:
        raise InputError("--every", found=str(every), expected="1 or more")
    return tuple(i for i in image_ids if (i - image_ids[0]) % every == 0)


def late_deliveries(stamps_ns: Sequence[int]) -> tuple[Delivery, ...]:
    """When each request is answered, for fed frames with these ascending stamps; indices into them.

    Request k is due 200 k ms after the first stamp, looks at the newest frame at or before that, and is
    delivered with the first frame 200 ms or more after the looked-at one's stamp. Requests that would look
    at the same frame again are one.

    >>> late_deliveries([round(i * 1e9 / 30) for i in range(14)])[:2]
    (Delivery(looked_at=0, delivered=6), Delivery(looked_at=6, delivered=12))
    """
    deliveries: list[Delivery] = []
    looked_at = 0
    due = stamps_ns[0]
    while due <= stamps_ns[-1] + _TOLERANCE_NS:
        while looked_at + 1 < len(stamps_ns) and stamps_ns[looked_at + 1] <= due + _TOLERANCE_NS:
            looked_at += 1
        if not deliveries or deliveries[-1].looked_at != looked_at:
            ready = stamps_ns[looked_at] + PERIOD_NS - _TOLERANCE_NS
            later = (i for i in range(looked_at + 1, len(stamps_ns)) if stamps_ns[i] >= ready)
            deliveries.append(Delivery(looked_at, next(later, None)))
        due += PERIOD_NS
    return tuple(deliveries)

"""Detect faults in a camera's images, and describe them in sentences.

A fault is reported when it has lasted for half a second. Three kinds have another time: an image that stays
the same (a little sooner, because until then poses are TRACKING without evidence), a low rate (when it is
sure that the camera has not stopped instead), and an image without colours (later, because a scene may look
so for a moment).
"""

from __future__ import annotations

from collections import deque

import numpy as np

from huepose.geometry import Camera
from huepose.geometry.image_faults import DARK, LEAST_DEPTH, all_dark, all_grey, depth_share, readings
from huepose.support.words import rounded
from huepose_services.camera.live import Shot
from huepose_services.runtime.clock import SECOND

LASTS_NS = SECOND // 2
"""A fault must be in all images for this long: a single bad image is not reported."""

RATE_WINDOW_NS, RATE_WINDOW_PICTURES = SECOND, 3
"""The rate is counted in RATE_WINDOW_NS, or in the time of RATE_WINDOW_PICTURES images if that is
longer."""
LEAST_OF_RATE = 0.8
"""Share of the images that are due; fewer in that time cannot be chance."""

MOST_APART = 0.75
"""Share of the time between two images by which colour and depth may differ: synchronisers pair them up to
half of it apart."""

MILLIMETRES_OVER_M = 50.0
"""No depth camera measures this far: larger numbers are millimetres that were read as metres."""

CHANGE_SAID_NS = 10 * SECOND
"""For this long a change that happened at one moment is reported."""

STOPPED = "stopped"
"""The complaint about a camera whose images have changed since it was opened, and now do not change any
more."""

STOPPED_NS = 4 * SECOND // 10
"""The image must stay the same for this long: a source may send each image of a slower sensor several
times."""

GREY_NS = 2 * SECOND
"""The image must be without colours for this long: a real scene may look so for a moment, such as a white
wall close to the lens."""

AHEAD_S, BEHIND_S = 1.0, 60.0
"""Limits for the timestamp relative to the arrival: no capture takes place after it, and no driver keeps an
image for so long."""

_LASTS_NS = {STOPPED: STOPPED_NS, "grey": GREY_NS}


class Condition:
    """Call `look` for every image; `complaints` returns the faults that last now. rate_hz: the expected
    rate; farthest_m: farther depth counts as no reading; check: whether an image that stays the same after
    changing ones means that the camera has stopped."""

    def __init__(self, rate_hz: float, farthest_m: float, check: bool = True) -> None:
        self._rate_hz, self._farthest_m, self._check = rate_hz, farthest_m, check
        self._since: dict[str, tuple[int, str]] = {}
        self._counts: deque[tuple[int, int]] = deque()
        self._came_ns = 0
        self._least_window_ns = self._window_ns = self._window_of(SECOND / rate_hz)
        self._camera: Camera | None = None
        self._last: Shot | None = None
        self._moved = False
        self._changes: dict[str, tuple[int, str]] = {}

    def look(self, shot: Shot, now_ns: int, clock_is_host: bool = False) -> bool:
        """Examine an image of the open camera. Returns whether it may be used: colour and depth are of the
        same time. clock_is_host: whether its timestamp is CLOCK_MONOTONIC."""
        apart = self._apart(shot)
        unchanged = self._is_unchanged(shot)
        stopped = self._moved and self._check
        for kind, text in (
            ("dark", _dark(shot)),
            ("grey", _GREY if all_grey(shot.color) else None),
            ("depth", _no_depth(shot, self._farthest_m)),
            ("apart", apart),
            ("stamp", _one_stamp(shot, self._last)),
            ("clock", _another_clock((shot.device_ns - shot.arrived_ns) / SECOND) if clock_is_host else None),
            ("again", _AGAIN if unchanged and not stopped else None),
            (STOPPED, _STOPPED if unchanged and stopped else None),
        ):
            if text is None:
                self._since.pop(kind, None)
            else:
                self._since[kind] = (self._since.get(kind, (now_ns, ""))[0], text)
        before, self._camera, self._last = self._camera, shot.camera, shot
        if before is not None and before != shot.camera:
            self._changes["change"] = (now_ns, _changed(before, shot.camera))
        return apart is None

    def count(self, images: int, now_ns: int) -> None:
        """Take the number of images since the camera was opened; to be called often."""
        if self._counts and images < self._counts[-1][1]:
            self._counts.clear()
        self._measure(images, now_ns)
        self._counts.append((now_ns, images))
        while len(self._counts) > 2 and now_ns - self._counts[1][0] > self._window_ns:
            self._counts.popleft()
        seconds = (now_ns - self._counts[0][0]) / SECOND
        came = images - self._counts[0][1]
        since_ns = self._since.get("rate", (now_ns, ""))[0]
        enough = came >= LEAST_OF_RATE * self._rate_hz * seconds
        if seconds < self._least_window_ns / SECOND or enough:
            self._since.pop("rate", None)
        elif came:
            rate_hz = came / seconds
            shown = f"{rate_hz:.0f}" if rate_hz >= 1.0 else rounded(rate_hz)
            text = (
                f"it gives {shown} images a second instead of {self._rate_hz:g}: a long "
                "exposure in the dark, a slow cable or port, a busy computer, or a source of your own that "
                "waits too long"
            )
            # A complaint that was reported once stays, also if the window changes its length.
            self._since["rate"] = (since_ns if now_ns - since_ns < self._window_ns else 0, text)
        elif self._came_ns - since_ns < self._window_ns:
            # No image comes, and the rate was not reported when the last one came: the reader says why none
            # comes.
            self._since.pop("rate", None)

    def _measure(self, images: int, now_ns: int) -> None:
        """Make the window longer if images come seldom."""
        new = images - self._counts[-1][1] if self._counts else 0
        if new:
            self._window_ns = max(self._least_window_ns, self._window_of((now_ns - self._came_ns) / new))
        if new or not self._counts:
            self._came_ns = now_ns

    @staticmethod
    def _window_of(period_ns: float) -> int:
        return max(RATE_WINDOW_NS, round(RATE_WINDOW_PICTURES * period_ns))

    def reopened(self) -> None:
        """Forget everything: the camera was opened again."""
        self._since.clear()
        self._counts.clear()
        self._window_ns = self._least_window_ns
        self._changes.clear()
        self._camera = self._last = None
        self._moved = False

    def went_back(self, by_ns: int, now_ns: int) -> None:
        """Take that the newest image's timestamp is by_ns older than an earlier one."""
        self._changes["back"] = (
            now_ns,
            f"its timestamps went back by {rounded(by_ns / SECOND)} s while it was open: all objects are "
            "searched for again. A recording that is repeated needs timestamps that go on",
        )

    def complaints(self, now_ns: int) -> dict[str, str]:
        """The faults that last now, as sentences by kind."""
        # For a whole window the count still has images from before the camera stopped or became slow.
        lasts_ns = {**_LASTS_NS, "rate": self._window_ns}
        lasting = {
            kind: text
            for kind, (since, text) in self._since.items()
            if now_ns - since >= lasts_ns.get(kind, LASTS_NS)
        }
        recent = {kind: text for kind, (at, text) in self._changes.items() if now_ns - at < CHANGE_SAID_NS}
        return lasting | recent

    def _is_unchanged(self, shot: Shot) -> bool:
        """Whether an image is the same as the one before, bit by bit, but with a new number and
        timestamp."""
        last = self._last
        if last is None or shot.number == last.number or shot.device_ns == last.device_ns:
            return False
        unchanged = shot.shows_the_same(last)
        self._moved |= not unchanged
        return unchanged

    def _apart(self, shot: Shot) -> str | None:
        """The complaint that colour and depth were captured at different times; None if they were not."""
        if shot.depth_ns is None:
            return None
        apart_ns = shot.device_ns - shot.depth_ns
        if abs(apart_ns) <= MOST_APART * SECOND / self._rate_hz:
            return None
        return (
            f"depth is {rounded(abs(apart_ns) * 1e-6)} ms {'older' if apart_ns > 0 else 'newer'} than "
            "colour: such images are left out. Both streams must have the same rate; else plug the camera in "
            "again"
        )


_GREY = (
    "its image has no colour (red, green and blue are alike), but objects are recognised by their colours: "
    "is it from an infrared or a monochrome sensor?"
)
_AGAIN = "it gives the same image again and again: is it a still image, or has the camera stopped?"
_STOPPED = (
    "its image has changed before and now does not change in a single bit, so the camera has stopped: start "
    "it again. No pose is TRACKING until another image comes; for still images set camera.check: false"
)


def _one_stamp(shot: Shot, last: Shot | None) -> str | None:
    if last is None or shot.number == last.number or shot.device_ns != last.device_ns:
        return None
    return "all its images have the same timestamp: each needs that of its own capture"


def _another_clock(seconds: float) -> str | None:
    """The complaint about a timestamp that is far ahead of this computer's clock, or behind it (negative);
    None if it is not."""
    clock, fix = "this computer's CLOCK_MONOTONIC", "Give the time.monotonic_ns() of the capture"
    if seconds > AHEAD_S:
        taken = "so the time of arrival is taken instead"
        return f"its timestamps are {rounded(seconds)} s ahead of {clock}, {taken}. {fix}"
    if seconds < -BEHIND_S:
        old = "so every pose is too old to be acted on"
        return f"its timestamps are {rounded(-seconds)} s behind {clock}, {old}. {fix}"
    return None


def _dark(shot: Shot) -> str | None:
    if not all_dark(shot.color):
        return None
    return f"its image is black (under {DARK} of 255): check the lens, the light, the exposure"


def _no_depth(shot: Shot, farthest_m: float) -> str | None:
    if depth_share(shot.depth, farthest_m) >= LEAST_DEPTH:
        return None
    if depth_share(shot.depth) >= LEAST_DEPTH:
        median_m = float(np.median(shot.depth[readings(shot.depth)]))
        if median_m > MILLIMETRES_OVER_M:
            return (
                f"depth looks like millimetres read as metres (half of it is farther than "
                f"{rounded(median_m)} m): a camera of your own gives metres, so multiply by 0.001"
            )
        return (
            f"its depth is farther than {farthest_m:.1f} m, half of it farther than {rounded(median_m)} m, "
            "and is not sent: is the depth scale right? If so, set camera.depth_scale_m to send more"
        )
    return (
        f"no depth: under {100.0 * LEAST_DEPTH:.0f} % of the image has a reading up to {farthest_m:.1f} m. "
        "Check the lenses and the projector; surfaces that are too near have no reading either"
    )


def _changed(a: Camera, b: Camera) -> str:
    return (
        f"its image changed from {_described(a, b)} to {_described(b, a)} while it was open: all objects "
        "are searched for again"
    )


def _described(camera: Camera, other: Camera) -> str:
    """The size, and the values of the camera matrix that differ from the other's, with all digits."""
    values = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    matrix = "".join(f", {name} {x!r}" for name, x in values.items() if x != getattr(other, name))
    return f"{camera.width} x {camera.height}{matrix}"

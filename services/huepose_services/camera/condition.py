"""Detect what is wrong with a camera's pictures, and say it in words half a second after it began, that
they stand still a little sooner: until then poses are believed that nothing bears out; a slow rate when it
is known that the camera has not stopped instead; no colour when it is not what is shown just now."""

from __future__ import annotations

from collections import deque

import numpy as np

from huepose.geometry import Camera
from huepose.geometry.picture_faults import DARK, LEAST_DEPTH, all_dark, all_grey, depth_share, readings
from huepose.support.words import rounded
from huepose_services.camera.live import Shot
from huepose_services.runtime.clock import SECOND

LASTS_NS = SECOND // 2
"""So long must all pictures say the same: one that is spoilt is nothing."""

RATE_WINDOW_NS, RATE_WINDOW_PICTURES = SECOND, 3
"""Pictures are counted in so long a time, or in that of so many of them where it is longer."""
LEAST_OF_RATE = 0.8
"""Share of the pictures that are due; fewer cannot be chance in that time."""

MOST_APART = 0.75
"""Of the time between two pictures: synchronisers pair colour and depth that are up to half of it apart."""

MILLIMETRES_OVER_M = 50.0
"""No depth camera measures so far: such a number of metres is one of millimetres."""

CHANGE_SAID_NS = 10 * SECOND

STOPPED = "stopped"
"""The complaint about a camera that has shown different pictures since it was opened, and now one alone."""

STOPPED_NS = 4 * SECOND // 10
"""So long must it show that one: a source may send each picture of a slower sensor several times."""

GREY_NS = 2 * SECOND
"""For so long: a real scene may look so for a moment, as a white wall close to the lens."""

AHEAD_S, BEHIND_S = 1.0, 60.0
"""Seconds from the arrival: no capture takes place after it, and no driver keeps a picture so long."""

_LASTS_NS = {STOPPED: STOPPED_NS, "grey": GREY_NS}


class Condition:
    """Feed it every picture; `complaints` is what lasts now. rate_hz: how many should come;
    farthest_m: what is farther counts as no reading; check: whether a picture that stands still after
    others means that the camera has stopped."""

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
        """Take in a picture of the open camera; whether it may be used: colour and depth are of one time.
        clock_is_host: whether its stamp is CLOCK_MONOTONIC."""
        apart = self._apart(shot)
        stands = self._stands(shot)
        stopped = self._moved and self._check
        for kind, text in (
            ("dark", _dark(shot)),
            ("grey", _GREY if all_grey(shot.color) else None),
            ("depth", _no_depth(shot, self._farthest_m)),
            ("apart", apart),
            ("stamp", _one_stamp(shot, self._last)),
            ("clock", _another_clock((shot.device_ns - shot.arrived_ns) / SECOND) if clock_is_host else None),
            ("again", _AGAIN if stands and not stopped else None),
            (STOPPED, _STOPPED if stands and stopped else None),
        ):
            if text is None:
                self._since.pop(kind, None)
            else:
                self._since[kind] = (self._since.get(kind, (now_ns, ""))[0], text)
        before, self._camera, self._last = self._camera, shot.camera, shot
        if before is not None and before != shot.camera:
            self._changes["change"] = (now_ns, _changed(before, shot.camera))
        return apart is None

    def count(self, pictures: int, now_ns: int) -> None:
        """How many pictures came since the camera was opened; called often."""
        if self._counts and pictures < self._counts[-1][1]:
            self._counts.clear()
        self._measure(pictures, now_ns)
        self._counts.append((now_ns, pictures))
        while len(self._counts) > 2 and now_ns - self._counts[1][0] > self._window_ns:
            self._counts.popleft()
        seconds = (now_ns - self._counts[0][0]) / SECOND
        came = pictures - self._counts[0][1]
        since_ns = self._since.get("rate", (now_ns, ""))[0]
        enough = came >= LEAST_OF_RATE * self._rate_hz * seconds
        if seconds < self._least_window_ns / SECOND or enough:
            self._since.pop("rate", None)
        elif came:
            rate_hz = came / seconds
            told = f"{rate_hz:.0f}" if rate_hz >= 1.0 else rounded(rate_hz)
            text = (
                f"it gives {told} pictures a second instead of {self._rate_hz:g}: a long "
                "exposure in the dark, a slow cable or port, a busy computer, or a source of your own that "
                "waits too long"
            )
            # What is said stays while the window wavers.
            self._since["rate"] = (since_ns if now_ns - since_ns < self._window_ns else 0, text)
        elif self._came_ns - since_ns < self._window_ns:
            # Nothing was said when the last one came: of a camera that gives none its reader says why.
            self._since.pop("rate", None)

    def _measure(self, pictures: int, now_ns: int) -> None:
        """Count for longer where pictures come seldom."""
        new = pictures - self._counts[-1][1] if self._counts else 0
        if new:
            self._window_ns = max(self._least_window_ns, self._window_of((now_ns - self._came_ns) / new))
        if new or not self._counts:
            self._came_ns = now_ns

    @staticmethod
    def _window_of(period_ns: float) -> int:
        return max(RATE_WINDOW_NS, round(RATE_WINDOW_PICTURES * period_ns))

    def reopened(self) -> None:
        """What was said was of another opening of the camera."""
        self._since.clear()
        self._counts.clear()
        self._window_ns = self._least_window_ns
        self._changes.clear()
        self._camera = self._last = None
        self._moved = False

    def went_back(self, by_ns: int, now_ns: int) -> None:
        """The stamp of its newest picture is so much older than that of one before."""
        self._changes["back"] = (
            now_ns,
            f"its time stamps went back by {rounded(by_ns / SECOND)} s while it was open: all objects are "
            "searched for anew. A film that begins again needs stamps that go on",
        )

    def complaints(self, now_ns: int) -> dict[str, str]:
        """What lasts, by kind."""
        # Until then the last pictures of a camera that gives none at all count, and of one that has become
        # slow the good ones before.
        lasts_ns = {**_LASTS_NS, "rate": self._window_ns}
        lasting = {
            kind: text
            for kind, (since, text) in self._since.items()
            if now_ns - since >= lasts_ns.get(kind, LASTS_NS)
        }
        recent = {kind: text for kind, (at, text) in self._changes.items() if now_ns - at < CHANGE_SAID_NS}
        return lasting | recent

    def _stands(self, shot: Shot) -> bool:
        """Whether it is the picture before, to the last bit, with a stamp of its own."""
        last = self._last
        if last is None or shot.number == last.number or shot.device_ns == last.device_ns:
            return False
        stands = shot.shows_the_same(last)
        self._moved |= not stands
        return stands

    def _apart(self, shot: Shot) -> str | None:
        """They show the world at different times."""
        if shot.depth_ns is None:
            return None
        apart_ns = shot.device_ns - shot.depth_ns
        if abs(apart_ns) <= MOST_APART * SECOND / self._rate_hz:
            return None
        return (
            f"depth is {rounded(abs(apart_ns) * 1e-6)} ms {'older' if apart_ns > 0 else 'newer'} than "
            "colour: such pictures are left out. Both streams must have one rate; else plug the camera in "
            "again"
        )


_GREY = (
    "its picture has no colour (red, green and blue are alike), and objects are told by their colours: is it "
    "that of an infrared or a monochrome sensor?"
)
_AGAIN = "it gives the same picture again and again: a still one, or has the camera stopped?"
_STOPPED = (
    "its picture stands still to the last bit and has moved before, so the camera has stopped: start it "
    "anew. No pose is TRACKING until another picture comes; for still pictures set camera.check: false"
)


def _one_stamp(shot: Shot, last: Shot | None) -> str | None:
    if last is None or shot.number == last.number or shot.device_ns != last.device_ns:
        return None
    return "its pictures have one and the same time stamp: each needs that of its own capture"


def _another_clock(seconds: float) -> str | None:
    """That a stamp is so far ahead of this computer's clock, or behind it where negative."""
    clock, fix = "this computer's CLOCK_MONOTONIC", "Give the time.monotonic_ns() of the capture"
    if seconds > AHEAD_S:
        taken = "so the time of arrival is taken instead"
        return f"its time stamps are {rounded(seconds)} s ahead of {clock}, {taken}. {fix}"
    if seconds < -BEHIND_S:
        old = "so every pose is too old to be acted on"
        return f"its time stamps are {rounded(-seconds)} s behind {clock}, {old}. {fix}"
    return None


def _dark(shot: Shot) -> str | None:
    if not all_dark(shot.color):
        return None
    return f"its picture is black (under {DARK} of 255): look at the lens, the light, the exposure"


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
        f"no depth: under {100.0 * LEAST_DEPTH:.0f} % of the picture has a reading up to {farthest_m:.1f} m. "
        "Look at the lenses and the projector; what is too near gives none either"
    )


def _changed(a: Camera, b: Camera) -> str:
    return (
        f"its picture changed from {_told(a, b)} to {_told(b, a)} while it was open: all objects are "
        "searched for anew"
    )


def _told(camera: Camera, other: Camera) -> str:
    """Its size, and what of its matrix is not as in the other, with all digits: they may differ by little."""
    values = {name: float(getattr(camera, name)) for name in ("fx", "fy", "cx", "cy")}
    matrix = "".join(f", {name} {x!r}" for name, x in values.items() if x != getattr(other, name))
    return f"{camera.width} x {camera.height}{matrix}"

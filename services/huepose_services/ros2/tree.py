"""Where one frame of ROS 2 is in another, from the transforms of /tf and /tf_static as they come."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from huepose_protos.messages import Mount
from huepose_protos.motion import composed, inverted, mount_at

_KEPT = 128
"""Transforms of an edge that are remembered: some seconds of a slow one, to meet the stamps of a fast one."""
_MOST_FRAMES = 4096

Told = tuple[int, str, Mount]
"""A transform: Unix time in ns, the frame that is placed, and where it is in its parent."""


@dataclass
class _Edge:
    """From a frame to its parent; static: it holds at any time."""

    parent: str
    static: bool
    told: deque[tuple[int, Mount]] = field(default_factory=lambda: deque(maxlen=_KEPT))


class Tree:
    """The frames of a robot, of which that of `child` in `parent` is asked for: along a chain of any length,
    also where neither is above the other."""

    def __init__(self, parent: str, child: str) -> None:
        self._parent, self._child = parent, child
        self._edges: dict[str, _Edge] = {}
        self._given_ns = 0

    @property
    def frames(self) -> tuple[str, ...]:
        """Names of all frames that were heard of, in order."""
        return tuple(sorted({*self._edges, *(edge.parent for edge in self._edges.values())}))

    def take(self, transforms: Iterable[Told], static: bool) -> None:
        """Transforms of one message, of /tf_static or of /tf. One that is not newer than what is known of its
        frame is left out; a clock that was set back by over a second begins anew."""
        for stamp_ns, name, mount in transforms:
            edge = self._edges.get(name)
            if edge is None or edge.parent != mount.parent or edge.static != static:
                if edge is None and len(self._edges) >= _MOST_FRAMES:
                    continue
                edge = self._edges[name] = _Edge(mount.parent, static)
            if static:
                edge.told.clear()
            elif edge.told and stamp_ns <= edge.told[-1][0]:
                if edge.told[-1][0] - stamp_ns < 1_000_000_000:
                    continue
                edge.told.clear()
                self._given_ns = 0
            edge.told.append((stamp_ns, mount))

    def newest(self, now_ns: int) -> tuple[int, Mount] | None:
        """The newest stamp at which all of the way is known, and where `child` is in `parent` then; None if
        that was said already. A way of static transforms alone is known at now_ns, in Unix time."""
        way = self._way()
        if way is None:
            return None
        up, down = way
        moving = [edge.told[-1][0] for edge in (*up, *down) if not edge.static]
        stamp_ns = min(moving, default=now_ns)
        if stamp_ns <= self._given_ns:
            return None
        T_meet_child, T_meet_parent = _placed(up, stamp_ns), _placed(down, stamp_ns)
        if T_meet_child is None or T_meet_parent is None:
            return None
        self._given_ns = stamp_ns
        return stamp_ns, composed(inverted(T_meet_parent, self._parent), T_meet_child)

    @property
    def moving(self) -> bool:
        """Whether an edge of the way is no static one."""
        way = self._way()
        return way is not None and any(not edge.static for edge in (*way[0], *way[1]))

    @property
    def known(self) -> bool:
        """Whether there is a way from one frame to the other."""
        return self._way() is not None

    def _way(self) -> tuple[list[_Edge], list[_Edge]] | None:
        """The edges from `child` and those from `parent` up to the frame that both hang on."""
        up, down = dict(self._ups(self._child)), dict(self._ups(self._parent))
        names = [self._child, *(edge.parent for edge in up.values())]
        others = [self._parent, *(edge.parent for edge in down.values())]
        meet = next((name for name in names if name in others), None)
        if meet is None:
            return None
        return list(up.values())[: names.index(meet)], list(down.values())[: others.index(meet)]

    def _ups(self, name: str) -> Iterator[tuple[str, _Edge]]:
        seen: set[str] = set()
        while (edge := self._edges.get(name)) is not None and name not in seen:
            seen.add(name)
            yield name, edge
            name = edge.parent


def _placed(edges: Iterable[_Edge], stamp_ns: int) -> Mount | None:
    """Where the frame of the first edge is in the parent of the last; None where one is not known then."""
    T = Mount(parent="itself", translation=(0.0, 0.0, 0.0))
    for edge in edges:
        newest_ns, place = edge.told[-1]
        if not edge.static and stamp_ns != newest_ns:
            between = mount_at(list(edge.told), stamp_ns)
            if between is None:
                return None
            place = between
        T = composed(place, T)
    return T

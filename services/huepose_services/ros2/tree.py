"""The pose of one frame of ROS 2 in another, from the transforms of /tf and /tf_static as they arrive."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, field

from huepose_protos.messages import Mount
from huepose_protos.motion import composed, inverted, mount_at
from huepose_services.runtime.clock import SECOND

_KEPT = 128
"""Transforms that are kept of each edge: some seconds of a slow edge, to interpolate at the timestamps of a
fast one."""
_MOST_FRAMES = 4096

StampedTransform = tuple[int, str, Mount]
"""Unix time in ns, the name of the child frame, and its pose in its parent frame."""


@dataclass
class _Edge:
    """From a frame to its parent, with its newest transforms. A static edge holds at any time."""

    parent: str
    static: bool
    transforms: deque[tuple[int, Mount]] = field(default_factory=lambda: deque(maxlen=_KEPT))


class Tree:
    """The transform tree of a robot; it gives the pose of `child` in `parent`, over a chain of any length, up
    and down the tree."""

    def __init__(self, parent: str, child: str) -> None:
        self._parent, self._child = parent, child
        self._edges: dict[str, _Edge] = {}
        self._returned_ns = 0

    @property
    def frames(self) -> tuple[str, ...]:
        """The names of all frames in the tree, sorted."""
        return tuple(sorted({*self._edges, *(edge.parent for edge in self._edges.values())}))

    def take(self, transforms: Iterable[StampedTransform], static: bool) -> None:
        """Add the transforms of one message of /tf_static (static) or /tf. A transform that is not newer than
        the last one of its frame is ignored; one that is older by over a second means that the robot's clock
        was set back: the frame's history is dropped."""
        for stamp_ns, name, mount in transforms:
            edge = self._edges.get(name)
            if edge is None or edge.parent != mount.parent or edge.static != static:
                if edge is None and len(self._edges) >= _MOST_FRAMES:
                    continue
                edge = self._edges[name] = _Edge(mount.parent, static)
            if static:
                edge.transforms.clear()
            elif edge.transforms and stamp_ns <= edge.transforms[-1][0]:
                if edge.transforms[-1][0] - stamp_ns < SECOND:
                    continue
                edge.transforms.clear()
                self._returned_ns = 0
            edge.transforms.append((stamp_ns, mount))

    def newest(self, now_ns: int) -> tuple[int, Mount] | None:
        """The newest timestamp at which the whole chain is known, and the pose of `child` in `parent` at
        it. None if there is none newer than the last one returned. A chain of static transforms alone is
        known at now_ns, in Unix time, also when that clock was set back."""
        chain = self._chain()
        if chain is None:
            return None
        up, down = chain
        moving = [edge.transforms[-1][0] for edge in (*up, *down) if not edge.static]
        stamp_ns = min(moving, default=now_ns)
        if moving and stamp_ns <= self._returned_ns:
            return None
        T_common_child, T_common_parent = _composed(up, stamp_ns), _composed(down, stamp_ns)
        if T_common_child is None or T_common_parent is None:
            return None
        self._returned_ns = stamp_ns if moving else 0
        return stamp_ns, composed(inverted(T_common_parent, self._parent), T_common_child)

    @property
    def moving(self) -> bool:
        """Whether an edge of the chain is not static."""
        chain = self._chain()
        return chain is not None and any(not edge.static for edge in (*chain[0], *chain[1]))

    @property
    def connected(self) -> bool:
        """Whether there is a chain between the two frames."""
        return self._chain() is not None

    def _chain(self) -> tuple[list[_Edge], list[_Edge]] | None:
        """The edges from `child`, and those from `parent`, up to their nearest common ancestor."""
        up, down = self._edges_up_from(self._child), self._edges_up_from(self._parent)
        names = [self._child, *(edge.parent for edge in up)]
        others = [self._parent, *(edge.parent for edge in down)]
        common = next((name for name in names if name in others), None)
        if common is None:
            return None
        return up[: names.index(common)], down[: others.index(common)]

    def _edges_up_from(self, name: str) -> list[_Edge]:
        """The edges from a frame up to its root, or once round a loop."""
        edges: dict[str, _Edge] = {}
        while name in self._edges and name not in edges:
            edges[name] = self._edges[name]
            name = edges[name].parent
        return list(edges.values())


def _composed(edges: Iterable[_Edge], stamp_ns: int) -> Mount | None:
    """The pose of the first edge's frame in the last edge's parent; None if an edge has none then."""
    T = Mount(parent="itself", translation=(0.0, 0.0, 0.0))
    for edge in edges:
        newest_ns, mount = edge.transforms[-1]
        if not edge.static and stamp_ns != newest_ns:
            between = mount_at(list(edge.transforms), stamp_ns)
            if between is None:
                return None
            mount = between
        T = composed(mount, T)
    return T

"""Which of many objects is searched for first: those that what is new in the picture looks like.

To compare some windows of the picture with the views of twenty objects takes as long as a search for a few of
them. So where many are missing, windows that have changed are compared with them all, once; what these look
like is searched for at once, the rest when it is its turn. Before a camera that moves everything would be new
in each look, so there it is done once for each size of object.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from huepose.geometry.arrays import Bool
from huepose.perception.config import PICKED
from huepose.perception.memory import CHANGED, MUCH, Memory
from huepose.perception.stillness import changed_shares
from huepose.perception.window_table import LIKE, WindowTable, compared, promising
from huepose.perception.windows import Windows, WindowsBySize

EACH, AT_ONCE = 20, 240
"""Windows that are compared with one object, those on pieces of their own or with its hues first, as in a
first search; and windows that are coded for this in one look, nearly: 0.1 CPU seconds. Chosen for time."""


@dataclass(frozen=True)
class Attention:
    """What was compared. looks: by size of window, the look in which everything new was compared; likeness:
    by object, of what is new and was not searched for yet; searched: by object, of what was searched for in
    vain. Likenesses are the highest, of a window and a view."""

    looks: Mapping[int, int] = field(default_factory=dict)
    likeness: Mapping[str, float] = field(default_factory=dict)
    searched: Mapping[str, float] = field(default_factory=dict)

    def picked(self, waiting: Collection[str]) -> list[str]:
        """Those of the waiting objects that are searched for now, likeliest first: something new looks like
        them, and more so than anything that was searched for in vain."""
        likely = {name: self.likeness.get(name, 0.0) for name in waiting}
        some = [name for name, x in likely.items() if x >= max(LIKE, self.searched.get(name, 0.0))]
        return sorted(some, key=lambda name: -likely[name])[:PICKED]

    def after(self, searched: Collection[str], missing: Collection[str]) -> Attention:
        """After a search for some of the missing objects. What is not missing any more begins anew."""
        known = {
            name: max(self.searched.get(name, 0.0), self.likeness.get(name, 0.0) if name in searched else 0.0)
            for name in missing
        }
        left = {name: x for name, x in self.likeness.items() if name in missing and name not in searched}
        return Attention(self.looks, left, known)


def attended(
    before: Attention,
    memory: Memory,
    windows: WindowsBySize,
    missing: Sequence[tuple[str, float, WindowTable]],
) -> Attention:
    """After a look at what is new. missing: objects, their diameters in metres and their views. Sizes that it
    has no time for come first in the next look."""
    looks, likeness, coded = dict(before.looks), dict(before.likeness), 0
    sizes, moves = {windows.size_of(diameter_m) for _, diameter_m, _ in missing}, _moves(memory)
    for size in sorted(sizes, key=lambda size: (looks.get(size, -1), size)):
        if coded >= AT_ONCE or (moves and size in looks):
            break
        here = windows.at(size)
        new = _new(memory, here, looks.get(size))
        looks[size] = memory.look
        if not new.any():
            continue
        for name, diameter_m, table in missing:
            if windows.size_of(diameter_m) != size:
                continue
            order = promising(table, here)
            some = order[new[order]][:EACH]
            coded += here.uncoded(some)
            likeness[name] = max(likeness.get(name, 0.0), float(compared(table, here, some).max()))
    return Attention(looks, likeness, before.searched)


def _moves(memory: Memory) -> bool:
    """Whether most of the picture has changed since the last look."""
    last = memory.look - 1
    return last in memory.tiles and float(memory.changed_since(last).mean()) > MUCH


def _new(memory: Memory, windows: Windows, look: int | None) -> Bool:
    """Which windows (W,) have changed since a look: all where it is not remembered."""
    if look is None or look not in memory.tiles:
        return np.ones(len(windows), bool)
    changed = memory.changed_since(look)
    if not changed.any():
        return np.zeros(len(windows), bool)
    return np.asarray(changed_shares(changed, windows.frame_pixels, windows.span_px) > CHANGED)

"""The result of computing the poses of a recording again."""

from __future__ import annotations

from dataclasses import dataclass, field

from huepose.support.words import counted


@dataclass
class Report:
    """The result. steps: computed again, without_pose: those of them that gave none; skipped: steps that
    were not computed again, skipped_first: of these before the first that was; from_s, until_s: times of the
    first and the last of `steps`, seconds after the tracker's first message in the recording; poses,
    memories: found to be the same; unrecorded: poses that the recording lacks; difference: where and what the
    first difference is, or empty."""

    steps: int = 0
    without_pose: int = 0
    skipped: int = 0
    skipped_first: int = 0
    from_s: float = 0.0
    until_s: float = 0.0
    poses: int = 0
    unrecorded: int = 0
    memories: int = 0
    gaps: list[str] = field(default_factory=list)
    difference: str = ""

    @property
    def text(self) -> str:
        """The result in words."""
        if self.steps:
            without = f", {self.without_pose} of them without a pose" if self.without_pose else ""
            states = (
                f" and {counted(self.memories, 'recorded state')} of the tracker" if self.memories else ""
            )
            first = (
                f"{counted(self.steps, 'step')} of the tracker computed again, from {self.from_s:.2f} s to "
                f"{self.until_s:.2f} s of the recording{without}: {counted(self.poses, 'pose')}{states} "
                "compared, the same bit by bit"
            )
        elif self.skipped:
            first = (
                "nothing to compare: record for longer than ten seconds, or from before the pipeline begins"
            )
        else:
            first = (
                "nothing to compare: no step of the tracker is in it. Record while the tracker runs, and "
                "without --no-frames"
            )
        lines = [first]
        if self.difference:
            lines[0] += f", then not: {self.difference}"
        if self.skipped_first == 1 and self.steps:
            lines.append("not checked: the first step, after which the tracker's state is recorded")
        elif self.steps and self.skipped_first:
            lines.append(
                f"not checked: the {self.skipped_first} steps before {self.from_s:.2f} s. The tracker ran "
                "already when the recording began, and kept images from before; its state is recorded every "
                "five seconds, and this is the first state that depends on recorded images alone"
            )
        if later := self.skipped - self.skipped_first:
            lines.append(
                f"not checked: {counted(later, 'step')} after a gap, until the tracker's state is recorded "
                "again"
            )
        lines += [f"a gap: {gap}" for gap in self.gaps]
        if self.unrecorded:
            lines.append(f"not compared: {counted(self.unrecorded, 'pose')} that the recording lacks")
        return "\n".join(lines)

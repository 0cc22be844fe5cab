"""A view of a running pipeline as text: a line a worker, a line an object."""

from __future__ import annotations

from huepose_protos.messages import HealthMessage, PoseMessage
from huepose_services.runtime.config import WORKERS
from huepose_services.watch import View

_HEAD = (
    f"{'worker':10s} {'state':9s} {'rate':>6s} {'work ms':>13s} {'age ms':>13s} {'CPU':>5s} {'MiB':>5s} "
    f"{'locked':>6s} {'frames by':>10s} {'drops':>7s} {'errors':>6s}"
)


def as_text(view: View) -> str:
    """Several lines, without colour."""
    lines = [f"{view.pipeline.name} at port {view.pipeline.base_port}   {view.pipeline.file}".rstrip(), _HEAD]
    order = [w for w in WORKERS if w in view.health or w in view.missing or w in view.silent]
    for worker in order:
        message = view.health.get(worker)
        if worker in view.missing:
            lines.append(f"{worker:10s} is not there")
        elif message is None:
            lines.append(f"{worker:10s} is there and says nothing")
        else:
            lines.append(_worker(message, worker in view.silent))
    for message in view.health.values():
        lines += [f"  {message.worker}: {text}" for text in message.warnings]
        if message.last_error:
            lines.append(f"  {message.worker}, last error: {message.last_error.splitlines()[0]}")
    lines.append("")
    lines += [_pose(pose) for pose in view.poses.values()]
    for entry in view.objects:
        if entry.searching:
            lines.append(
                f"{entry.object:32s} SEARCHING  {entry.searching} of {entry.max_instances} never seen"
            )
            if entry.reason:
                lines.append(f"  {entry.reason}")
    return "\n".join(lines)


def _worker(m: HealthMessage, silent: bool) -> str:
    state = "silent" if silent else m.state
    path = {None: "-", True: "memory", False: "socket"}[m.shared_memory]
    return (
        f"{m.worker:10s} {state:9s} {m.rate_hz:6.1f} {_pair(m.work_ms):>13s} {_pair(m.age_ms):>13s} "
        f"{m.cpu_percent:4.0f}% {m.memory_mib:5.0f} {m.locked_mib:6.1f} {path:>10s} {m.drops:7d} "
        f"{m.errors:6d}"
    )


def _pair(values: tuple[float, float] | None) -> str:
    return "-" if values is None else f"{values[0]:.0f} p99 {values[1]:.0f}"


def _pose(pose: PoseMessage) -> str:
    who = f"{pose.object}/{pose.instance}"
    text = f"{who:32s} {pose.state:9s}  quality {pose.quality:.2f}"
    if pose.translation is not None:
        x, y, z = pose.translation
        text += f"  {x:+.3f} {y:+.3f} {z:+.3f} m"
    text += f"  {(pose.publish_ns - pose.capture_ns) * 1e-6:.0f} ms old"
    return f"{text}\n  {pose.reason}" if pose.reason else text

"""The zenoh session of a worker: a peer with explicit endpoints, on sockets that only their user can open,
with shared memory where it is safe.

A worker listens on its own port and connects to the workers before it in the list. So there is one link for
each pair, and each worker may start, die and restart at any time. Only the camera makes a pool of shared
memory. A reader that may not lock that pool would lose frames silently, so it turns shared memory off.
"""

from __future__ import annotations

import os
import resource
import shutil
from collections.abc import Sequence
from pathlib import Path

import zenoh

from huepose_protos.client import peer
from huepose_services.runtime.config import WORKERS, Config
from huepose_services.runtime.run_folder import make_folder
from huepose_services.runtime.running import port_taken

RESTARTS = "HUEPOSE_RESTARTS"
MIB = 1024 * 1024
# Memory that zenoh locks beside a pool, and for the links (measured with zenoh 1.10).
_POOL_OVERHEAD = 1280 * 1024
_LINK_OVERHEAD = 24 * 1024
# Batches of 64 KiB for each priority in use; the most that zenoh allows.
_BATCHES = 16
SHM = Path("/dev/shm")  # noqa: S108  # looked at, not written to
FRAME_WORKERS = ("camera", "tracker", "detector", "viewer", "uplink")


def lock_limit() -> int | None:
    """Bytes of memory that this process may lock; None without a limit (or with CAP_IPC_LOCK)."""
    soft, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if soft == resource.RLIM_INFINITY or _may_lock_anything():
        return None
    return soft


def _may_lock_anything() -> bool:
    cap_ipc_lock = 14
    try:
        status = Path("/proc/self/status").read_text()
    except OSError:
        return False
    effective = next((line.split()[1] for line in status.splitlines() if line.startswith("CapEff")), "0")
    return bool(int(effective, 16) >> cap_ipc_lock & 1)


def pool_fits(pool_bytes: int, limit: int | None, pools: int = 1) -> bool:
    """Whether a process with this limit can lock that many pools of frames."""
    return limit is None or pools * (pool_bytes + _POOL_OVERHEAD) + _LINK_OVERHEAD <= limit


def shared_memory_free() -> int:
    """Free bytes for shared memory; 0 if there is none."""
    try:
        return shutil.disk_usage(SHM).free
    except OSError:
        return 0


def pool_size(config: Config, limit: int | None) -> int:
    """Bytes of the camera's pool: as configured, which is enough for two readers of frames. If locked memory
    has no limit, half of that is added for each further reader."""
    configured = int(config.bus.frame_pool_mib * MIB)
    readers = sum(worker in config.workers for worker in FRAME_WORKERS if worker != "camera")
    return configured if limit is not None else configured * max(2, readers) // 2


def restarts() -> int:
    """How often the supervisor has restarted this worker."""
    text = os.environ.get(RESTARTS, "")
    return int(text) if text.isdigit() else 0


def zenoh_config(
    listen: Sequence[str],
    connect: Sequence[str],
    *,
    shared_memory: bool = False,
    pool_bytes: int = 0,
    more: dict[str, object] | None = None,
) -> zenoh.Config:
    """The configuration of a peer with exactly these endpoints. pool_bytes > 0: large puts go by shared
    memory; more: further settings of zenoh."""
    settings: dict[str, object] = {
        "transport/link/rx/max_message_size": 64 * MIB,
        # A process that waits for a processor must not lose messages meanwhile: the default of two batches
        # overflows with the poses of one frame.
        "transport/link/tx/queue/size": {"real_time": _BATCHES, "data": _BATCHES},
        "transport/shared_memory/enabled": shared_memory,
        "transport/shared_memory/transport_optimization/enabled": pool_bytes > 0,
    }
    if pool_bytes > 0:
        settings["transport/shared_memory/transport_optimization/pool_size"] = pool_bytes
    return peer(connect, listen, settings | (more or {}))


def _without_room(pool: int, limit: int | None, makes_it: bool) -> str | None:
    """What the lack of memory for the pool means, None if there is enough. makes_it: for the camera, which
    makes the pool, not for a reader."""
    limit_kib = (limit or 0) // 1024
    if not pool_fits(pool, limit):
        return (
            f"shared memory is off: frames need {(pool + _POOL_OVERHEAD) // 1024} KiB of locked memory, "
            f"the limit (ulimit -l) is {limit_kib} KiB; frames go by the socket"
        )
    if makes_it and not pool_fits(pool, limit, 1 + restarts()):
        return (
            f"shared memory is off after {restarts()} restarts: readers keep the old pools locked, and the "
            f"limit (ulimit -l) of {limit_kib} KiB has no room for another; frames go by the socket"
        )
    if makes_it and (free := shared_memory_free()) < pool:
        return (
            f"shared memory is off: frames need {pool // 1024} KiB in {SHM}, {free // 1024} KiB are free; "
            "frames go by the socket"
        )
    return None


def open_worker_session(config: Config, worker: str) -> tuple[zenoh.Session, str | None]:
    """The session of a worker, and a warning for its health or None. Raises InputError if its port is
    taken."""
    limit = lock_limit()
    pool = pool_size(config, limit)
    wanted = pool > 0 and worker in FRAME_WORKERS
    warning = _without_room(pool, limit, worker == "camera") if wanted else None
    shared = wanted and warning is None
    make_folder()
    before = WORKERS[: WORKERS.index(worker)]
    settings = zenoh_config(
        [config.endpoint(worker)],
        [config.endpoint(other) for other in before if other in config.workers],
        shared_memory=shared,
        pool_bytes=pool if shared and worker == "camera" else 0,
    )
    try:
        return zenoh.open(settings), warning
    except zenoh.ZError as error:
        raise port_taken(config, worker, _other_than_held(error)) from None


def _other_than_held(error: zenoh.ZError) -> str:
    """Zenoh's error; empty if another process holds the socket."""
    return "" if "acquire lock" in str(error) else " ".join(str(error).split())[:200]


def open_recorder_session(config: Config) -> zenoh.Session:
    """A session for every frame, by shared memory if that is allowed: on a busy machine sockets lose some."""
    limit = lock_limit()
    shared = pool_fits(pool_size(config, limit), limit)
    endpoints = [config.endpoint(worker) for worker in config.workers]
    return zenoh.open(zenoh_config([], endpoints, shared_memory=shared))


def open_reader_session(endpoints: Sequence[str]) -> zenoh.Session:
    """A session that only reads: it listens nowhere and uses no shared memory."""
    return zenoh.open(zenoh_config([], endpoints))


def open_player_session(config: Config) -> zenoh.Session:
    """A session in the place of a pipeline's workers: it listens on their ports, so that readers of any
    worker find it. Raises InputError if a port is taken."""
    make_folder()
    try:
        return zenoh.open(zenoh_config([config.endpoint(worker) for worker in config.workers], []))
    except zenoh.ZError as error:
        raise port_taken(config, config.workers[0], _other_than_held(error)) from None

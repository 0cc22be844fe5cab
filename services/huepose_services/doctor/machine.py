"""The machine: Python and packages, memory limits, clock, processor."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from huepose.support.extras import install_command, installed_version
from huepose_services.doctor.finding import Finding
from huepose_services.runtime.session import MIB, lock_limit, pool_fits

_PACKAGES = (
    *("huepose", "eclipse-zenoh", "numpy", "msgspec", "opencv-python-headless", "numba", "scipy"),
    *("onnxruntime", "onnxruntime-gpu", "open3d-cpu", "open3d", "rerun-sdk", "pyrealsense2", "depthai"),
)
_SHM = Path("/dev/shm")  # noqa: S108  # looked at, not written to
_CPUS = Path("/sys/devices/system/cpu")
_CLOCK_SOURCE = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")


def versions() -> Iterator[Finding]:
    """Python and packages."""
    right = (3, 10) <= sys.version_info[:2] <= (3, 12)
    yield Finding(
        "python",
        "ok" if right else "bad",
        f"{platform.python_version()} on {platform.machine()}, {os.cpu_count()} processors",
        "" if right else "Use Python 3.10, 3.11 or 3.12.",
    )
    have = {name: version for name in _PACKAGES if (version := installed_version(name))}
    yield Finding("packages", "ok", ", ".join(f"{name} {version}" for name, version in have.items()))
    if "onnxruntime" in have and "onnxruntime-gpu" in have:
        fix = "They are one module and overwrite each other: pip uninstall both, then install one."
        yield Finding("onnxruntime", "bad", "both onnxruntime and onnxruntime-gpu are installed", fix)
    if "numba" not in have:
        fix = f"To run a pipeline here: {install_command('edge')}."
        yield Finding("pipeline", "note", "only what subscribers need is installed", fix)


def memory(pool_mib: float) -> Iterator[Finding]:
    """Shared memory, and how much of it may be locked, for a pool of frames."""
    limit, pool = lock_limit(), int(pool_mib * MIB)
    text = "no limit" if limit is None else f"{limit // 1024} KiB"
    fits = pool == 0 or pool_fits(pool, limit)
    yield Finding(
        "locked memory",
        "ok" if fits else "note",
        f"{text}; frames need a pool of {pool_mib:g} MiB" + ("" if fits else ", so they go by the socket"),
        "" if fits else "Raise it (ulimit -l unlimited, LimitMEMLOCK=infinity), or lower bus.frame_pool_mib.",
    )
    if not os.access(_SHM, os.W_OK):
        fix = "Mount it: frames go by the socket without it. In a container: --shm-size=256m."
        yield Finding("shared memory", "note", f"{_SHM} is not there, or not writable", fix)
        return
    free = shutil.disk_usage(_SHM).free / MIB
    enough = free > 4 * pool_mib
    fix = "" if enough else "Make room in it, or make it larger: mount -o remount,size=256M /dev/shm."
    yield Finding("shared memory", "ok" if enough else "bad", f"{free:.0f} MiB free in {_SHM}", fix)


def clock() -> Iterator[Finding]:
    """The monotonic clock that every stamp is of."""
    resolution_ns = time.clock_getres(time.CLOCK_MONOTONIC) * 1e9
    source = _read(_CLOCK_SOURCE) or "unknown source"
    slow = source in ("hpet", "acpi_pm", "jiffies")
    fix = f"Reading {source} is slow and coarse; see the kernel's clocksource= option." if slow else ""
    yield Finding("clock", "note" if slow else "ok", f"{source}, resolution {resolution_ns:.0f} ns", fix)


def processor() -> Iterator[Finding]:
    """Whether the processor runs as fast as it can."""
    governors = {text for path in _CPUS.glob("cpu[0-9]*/cpufreq/scaling_governor") if (text := _read(path))}
    if not governors:
        yield Finding("governor", "none", "the system does not say how the processor's clock is governed")
    elif governors & {"powersave", "conservative"}:
        fix = "For even times: sudo cpupower frequency-set -g performance (on a Jetson: sudo jetson_clocks)."
        yield Finding("governor", "note", ", ".join(sorted(governors)), fix)
    else:
        yield Finding("governor", "ok", ", ".join(sorted(governors)))
    load, cores = os.getloadavg()[0], os.cpu_count() or 1
    busy = load > 1.5 * cores
    fix = "Other programs take the processor's time: times will be long and uneven." if busy else ""
    yield Finding("load", "note" if busy else "ok", f"{load:.1f} on {cores} processors", fix)


def _read(path: Path) -> str | None:
    try:
        return path.read_text().strip()
    except OSError:
        return None

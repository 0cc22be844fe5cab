"""`huepose units`: write systemd units for a pipeline.yaml.

These are a template for all workers, additions for single workers, and a target. The target starts exactly
the workers of the file, and the limits of `restarts` are those of `huepose up`. Each worker is a process of
an ordinary user. It has no access to devices, home folders or the network, except loopback and what its
work needs."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.files import write_text, writing
from huepose_services.cli.options import add_host, add_path, add_pipeline, say
from huepose_services.runtime.text import encodable
from huepose_services.runtime.threads import THREAD_VARIABLES

if TYPE_CHECKING:
    from huepose_services.runtime.config import Config

TEMPLATE, TARGET = "huepose@.service", "huepose.target"
_FIRST = ("camera", "tracker")
_FIRST_START = 5
_SLOW = 4
"""Factor of the watchdog time for all workers but camera and tracker. Unlike `huepose up`, systemd does not
double the time after a restart, and does not exclude the time in which other programs had the processors."""

_HIDDEN = ("/home", "/root", "/run/user", "/tmp", "/var/tmp")  # noqa: S108  # nothing is written there
"""Folders that ProtectHome and PrivateTmp hide from the services."""

_UNIT = """\
# Written by `huepose units`; run it again when pipeline.yaml changes.
[Unit]
Description=HuePose worker %i
PartOf={target}
StartLimitIntervalSec={window}
StartLimitBurst={burst}

[Service]
Type=notify
NotifyAccess=main
ExecStart={huepose} run %i {config}
# Reads pipeline.yaml again, applies what it can, and logs which changes need a restart.
ExecReload=/bin/kill -HUP $MAINPID
User={user}
WorkingDirectory=/var/lib/huepose
StateDirectory=huepose
CacheDirectory=huepose
Environment=XDG_CACHE_HOME=/var/cache/huepose NUMBA_CACHE_DIR=/var/cache/huepose/numba
# The workers' sockets: only this user can open the folder, which outlives single workers.
RuntimeDirectory=huepose
RuntimeDirectoryMode=0700
RuntimeDirectoryPreserve=yes
Environment=HUEPOSE_RUN=/run/huepose
Environment=HUEPOSE_NETWORKS=/var/lib/huepose/networks
Environment={threads}
# A worker that is killed because it hangs logs a stack trace.
Environment=PYTHONFAULTHANDLER=1 PYTHONUNBUFFERED=1
LimitCORE=0
UnsetEnvironment=LD_PRELOAD LD_LIBRARY_PATH PYTHONPATH PYTHONHOME

# After wrong input (2) a restart is useless; after any other failure the worker is restarted.
Restart=on-failure
RestartSec=1
RestartPreventExitStatus=2
# The first start compiles its kernels, which takes minutes on a small board.
TimeoutStartSec={start}
TimeoutStopSec=5
# The worker's loop sends the heartbeat, not a separate thread, so a worker that hangs is restarted.
WatchdogSec={watchdog}
# Frames go through shared memory, which is locked.
LimitMEMLOCK=infinity

NoNewPrivileges=yes
CapabilityBoundingSet=
AmbientCapabilities=
ProtectSystem=strict
ProtectHome=yes
PrivateTmp=yes
PrivateDevices=yes
DevicePolicy=closed
ProtectKernelTunables=yes
ProtectKernelModules=yes
ProtectKernelLogs=yes
ProtectControlGroups=yes
ProtectClock=yes
ProtectHostname=yes
ProtectProc=invisible
RestrictAddressFamilies=AF_UNIX AF_INET AF_INET6
RestrictNamespaces=yes
RestrictRealtime=yes
RestrictSUIDSGID=yes
LockPersonality=yes
KeyringMode=private
SystemCallArchitectures=native
SystemCallFilter=@system-service
SystemCallErrorNumber=EPERM
IPAddressDeny=any
IPAddressAllow=localhost
UMask=0077
"""

_CAMERA = """\
# The camera's own devices, and events when a device is plugged in.
PrivateDevices=no
DeviceAllow=char-usb_device rw
DeviceAllow=char-video4linux rw
DeviceAllow=char-media rw
DeviceAllow=char-hidraw rw
RestrictAddressFamilies=AF_NETLINK
"""

_GPU = """\
# The GPU: its device group has different names on different boards.
PrivateDevices=no
DevicePolicy=auto
"""

_NETWORK = """\
# Other machines can reach this worker.
IPAddressDeny=
IPAddressAllow=
"""


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("units", help="write systemd units for the workers of a pipeline")
    add_pipeline(parser)
    add_path(parser, "--out", "DIR", "folder to write, for example /etc/systemd/system", required=True)
    parser.add_argument(
        "--user", default="huepose", metavar="NAME", help="user of the processes (default: huepose)"
    )
    add_host(parser)
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Write the units, and remove additions for workers that the pipeline no longer has."""
    from huepose_services.runtime.config_file import load_all

    configs = [config.at(arguments.host) for config in load_all(arguments.config)]
    command = (Path(sys.executable).parent / "huepose").absolute()
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_.-]*", arguments.user):
        raise InputError("--user", found=arguments.user, expected="a user name")
    file = arguments.config.absolute()
    for path in (file, command):
        if (shown := encodable(str(path))) != str(path):
            found = "a path that is not in UTF-8, which systemd cannot read"
            raise InputError(shown, found=found, expected="another name", fix="Rename it or its folder.")
    files = units(configs, command, file, arguments.user)
    with writing(arguments.out, fix="Choose another folder with --out, or run it as root."):
        for old in arguments.out.glob("huepose@*.service.d/needs.conf"):
            if str(old.relative_to(arguments.out)) not in files:
                old.unlink()
        for name, text in files.items():
            path = arguments.out / name
            write_text(path, text)
            print(path)
    used = {"the configuration": file, "the program": command}
    used |= {"its Python": Path(sys.base_prefix)}
    for config in configs:
        used |= _named(config)
    hidden = {what: path for what, path in used.items() if _is_hidden(path)}
    if hidden:
        say(
            f"note: these units cannot work, because services have no access to {', '.join(_HIDDEN)}. Move "
            "the following elsewhere (files that the workers read to /etc/huepose or /var/lib/huepose):"
        )
        say("\n".join(f"  {what}: {path}" for what, path in hidden.items()))
    return 0


def _is_hidden(path: Path) -> bool:
    return any(one.is_relative_to(hidden) for one in (path, path.resolve()) for hidden in _HIDDEN)


def _named(config: Config) -> dict[str, Path]:
    """The paths in a configuration by their keys."""
    from huepose_services.runtime.config_perception import NETWORKS, PATHS, is_network_file

    found = {}
    unused = set() if config.hosts else {"link.secure"}
    for key in sorted((PATHS | NETWORKS) - unused):
        value: Any = config
        for part in key.split("."):
            value = getattr(value, part, None)
        if isinstance(value, str) and (key in PATHS or is_network_file(value)):
            found[key] = Path(value)
    return found


def units(configs: Sequence[Config], huepose: PurePath, config_path: PurePath, user: str) -> dict[str, str]:
    """The contents of the unit files by name, relative to the folder of the units.

    configs: one for each camera of pipeline.yaml; huepose: path of the command; config_path: path of
    pipeline.yaml when the units run; both absolute; user: of the processes."""
    restarts = configs[0].restarts
    files = {
        TEMPLATE: _UNIT.format(
            target=TARGET,
            window=f"{restarts.window_s:g}",
            burst=restarts.limit + 1,
            huepose=_quoted(huepose),
            config=_quoted(config_path),
            user=user,
            threads=" ".join(f"{name}=1" for name in THREAD_VARIABLES),
            start=f"{_FIRST_START * restarts.start_within_s:g}",
            watchdog=f"{_SLOW * restarts.patience_s('estimator'):g}",
        ),
        TARGET: _target(configs),
    }
    for config, worker, unit in _instances(configs):
        if extra := _extra(config, worker):
            files[f"{unit}.d/needs.conf"] = extra
    return files


def _instances(configs: Sequence[Config]) -> Iterator[tuple[Config, str, str]]:
    """Each worker with its configuration and its unit; `huepose run` gets the unit's instance name."""
    for config in configs:
        of = f"{config.camera.name}." if len(configs) > 1 else ""
        yield from ((config, worker, f"huepose@{of}{worker}.service") for worker in config.workers)


def _target(configs: Sequence[Config]) -> str:
    wants = "".join(f"Wants={unit}\n" for _, _, unit in _instances(configs))
    site = configs[0].site
    return f"[Unit]\nDescription=HuePose, site {site}\n{wants}\n[Install]\nWantedBy=multi-user.target\n"


def _extra(config: Config, worker: str) -> str:
    """The additions to the template for a worker; empty if it needs none."""
    service = ""
    if worker in _FIRST:
        service += "# Camera and tracker get CPU time first if there are too few cores.\nNice=-5\n"
        service += f"WatchdogSec={config.restarts.patience_s(worker):g}\n"
    if worker == "camera" and config.camera.source in ("realsense", "oak", "python"):
        service += _CAMERA
        service += _NETWORK if config.camera.source != "realsense" else ""
    if worker in ("gateway", "viewer", "ros2", "uplink", "downlink"):
        service += _NETWORK
    if worker in config.network_workers and {"cuda", "tensorrt"} & set(config.networks.providers):
        service += _GPU
    return f"[Service]\n{service}" if service else ""


def _quoted(path: PurePath) -> str:
    """A path as one word of a command line in a unit."""
    text = str(path).replace("\\", r"\\").replace('"', r"\"").replace("%", "%%").replace("$", "$$")
    return f'"{text}"' if any(c in text for c in " \t'\";") else text

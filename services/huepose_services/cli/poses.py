"""`huepose poses`: print what a pipeline publishes, one message a line, from this machine or a gateway."""

from __future__ import annotations

import argparse
import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose.support.words import counted, did_you_mean
from huepose_services.cli.gateway_source import Gateway, gateway_of
from huepose_services.cli.options import (
    LOOK_EVERY_S,
    SAY_WAITING_AFTER_S,
    add_choice,
    add_path,
    catch_stop_signals,
    chosen,
    say,
    wait_for_pipeline,
)

if TYPE_CHECKING:
    from huepose_protos.client import Reader
    from huepose_protos.messages import HealthMessage, Message
    from huepose_services.runtime.running import Pipeline


_POSES = "pose/**"
# Keys that look like an object's name.
_NAMES = frozenset({"frame", "truth", "camera", "mount", "objects", "control", "correction"})
_CSV_HELP = (
    "write TRACKING poses to a new file instead, one per row: frame, object, position in "
    "metres, quaternion x y z w (both in the camera's frame), instance, capture time in "
    "seconds, quality. While a recording is played, the time is that of playback, and "
    "`frame` is the number of the image in the recording; in a loop it keeps counting"
)
_HEADING = (
    " frame object/instance state quality   position x y z   rotation as a quaternion x y z w   "
    "age from capture to publishing   reason"
)
_NUMBER = re.compile(r"(?<![\w/.])[0-9]+([.][0-9]+)?(?!\w)")
"""A number that stands alone: not a part of a name, nor the number of an instance."""
_GONE_AFTER_S = 1.0


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser("poses", help="print the poses of a running pipeline")
    parser.add_argument(
        "key",
        nargs="?",
        default=_POSES,
        type=_key,
        metavar="OBJECT|KEY",
        help="an object's name, for its poses; or a message key after huepose/SITE/CAMERA/ (default: "
        "pose/**; also health/**, objects, truth)",
    )
    parser.add_argument("--json", action="store_true", help="one whole message per line, as JSON")
    parser.add_argument(
        "--robot",
        action="store_true",
        help="poses in the frame `parent` of camera.mount in pipeline.yaml",
    )
    add_path(parser, "--csv", "FILE.csv", _CSV_HELP)
    add_path(
        parser,
        "--tum",
        "DIR",
        "write TRACKING poses to a new folder instead, one OBJECT_INSTANCE.txt per instance, in "
        "TUM's format, with times as for --csv",
    )
    add_choice(parser)
    parser.add_argument(
        "--gateway", metavar="HOST[:PORT]", help="read from another machine's gateway (port 7447)"
    )
    parser.add_argument(
        "--tls",
        type=Path,
        nargs=3,
        metavar=("AUTHORITY", "CERTIFICATE", "KEY"),
        help="for a gateway with TLS: PEM files of its authority, and of your own certificate and key",
    )
    parser.set_defaults(call=call)


def _key(text: str) -> str:
    """The key for the first argument; a name that is not a key means the poses of that object. Raises
    ArgumentTypeError for a text that cannot be a key.

    >>> _key("mug"), _key("objects"), _key("pose/mug/0")
    ('pose/mug/**', 'objects', 'pose/mug/0')
    """
    import zenoh

    from huepose_protos.fields import is_name

    if is_name(text) and text not in _NAMES:
        return f"pose/{text}/**"
    try:
        return str(zenoh.KeyExpr.autocanonize(text))
    except zenoh.ZError:
        expected = "an object's name, or a key such as pose/** or objects"
        raise argparse.ArgumentTypeError(f"found '{text}', expected {expected}") from None


def call(arguments: argparse.Namespace) -> int:
    """Print until interrupted, or until the pipeline of this machine has ended."""
    gateway, stopping = gateway_of(arguments), catch_stop_signals()
    if arguments.csv is not None or arguments.tum is not None:
        return _write(arguments, _messages(arguments, gateway, stopping))
    headed = arguments.json or not arguments.key.startswith("pose/")
    source = _poses_on_robot if arguments.robot else _messages
    for message in source(arguments, gateway, stopping):
        if not headed:
            say(_HEADING)
            headed = True
        _print(message, arguments.json)
    return 0


def _write(arguments: argparse.Namespace, messages: Iterator[Message]) -> int:
    """Write poses to files until interrupted; exit code 1 if there were none."""
    from huepose_services.cli.pose_export import PoseFiles

    beside = [
        name
        for name, given in (
            ("--json", arguments.json),
            ("--robot", arguments.robot),
            (arguments.key, not arguments.key.startswith("pose/")),
        )
        if given
    ]
    if beside:
        raise InputError(
            "--csv and --tum", found=f"{beside[0]} beside it", expected="poses, in the camera's frame"
        )
    with PoseFiles(arguments.csv, arguments.tum) as files:
        for message in messages:
            files.take(message)
    say(f"{counted(files.written, 'pose')} written")
    return 0 if files.written else 1


def _messages(
    arguments: argparse.Namespace, gateway: Gateway | None, stopping: Callable[[], bool]
) -> Iterator[Message]:
    """The messages of the chosen key, until interrupted, or until the pipeline of this machine has ended."""
    check = _ObjectCheck(arguments.key)
    if gateway is None:
        yield from _messages_here(arguments, stopping, check)
        return
    for message in gateway.messages(arguments.key, stopping, *check.keys):
        if not check.consumes(message):
            yield message


class _ObjectCheck:
    """Checks that the pipeline searches for the object whose poses a key asks for, by its list of objects.

    keys: the key of that list; empty if the key is not for the poses of one object."""

    def __init__(self, key: str) -> None:
        match = re.fullmatch(r"pose/([^/*]+)/.+", key)
        self._name = match and match[1]
        self.keys = ("objects",) if match else ()

    def consumes(self, message: Message) -> bool:
        """Whether the message is such a list, which is not printed. Raises InputError if the object is not
        in the first list; it may be missing in later ones, because it can be removed at any time."""
        from huepose_protos.messages import ObjectsMessage

        if not (self.keys and isinstance(message, ObjectsMessage)):
            return False
        if self._name is None:
            return True
        name, self._name = self._name, None
        known = [entry.object for entry in message.objects]
        if name not in known:
            raise InputError(
                name,
                found="no object of that name that is searched for",
                expected=f"one of {', '.join(known)}" if known else "one that is: none is now",
                fix=did_you_mean(name, known) or f"Search for it: huepose objects add {name}",
            )
        return True


_NO_CAMERA_POSE = (
    "poses arrive, but the camera pose is not known. For a fixed camera, set camera.mount in pipeline.yaml. "
    "For a moving one (camera.moving, camera.tf), send it by MountSender of huepose_protos, or by /tf and "
    "the worker ros2 (docs/ros2.md)"
)


def _poses_on_robot(
    arguments: argparse.Namespace, gateway: Gateway | None, stopping: Callable[[], bool]
) -> Iterator[Message]:
    """Poses in the robot's frame, until interrupted. Raises InputError if another key is given."""
    from huepose_protos.pose_client import PoseClient

    if arguments.key != _POSES:
        raise InputError("--robot", found=f"{arguments.key} beside it", expected="poses, a line each")
    endpoints = _endpoints_of_mounted(arguments) if gateway is None else [gateway.endpoint]
    files = {} if gateway is None or gateway.credentials is None else gateway.credentials._asdict()
    say_at, said = time.monotonic() + SAY_WAITING_AFTER_S, ""
    with PoseClient(endpoints, **files) as client:
        while not stopping():
            pose = client.next(LOOK_EVERY_S)
            there = None if pose is None else client.on_robot(pose)
            if there is not None:
                say_at, said = time.monotonic() + SAY_WAITING_AFTER_S, ""
                yield there
            elif time.monotonic() > say_at:
                say_at = time.monotonic() + SAY_WAITING_AFTER_S
                unplaced = client.latest(max_age_s=SAY_WAITING_AFTER_S) is not None
                before, said = said, _NO_CAMERA_POSE if unplaced else client.why_silent()
                if said != before:
                    say(said)


def _endpoints_of_mounted(arguments: argparse.Namespace) -> list[str]:
    """Where the workers of the pipeline listen. Raises InputError if its file has neither a mount nor
    another source of the camera pose."""
    from huepose_services.runtime.config_file import load

    pipeline = chosen(arguments)
    if Path(pipeline.file).is_file() and not pipeline.recorded:
        camera = load(Path(pipeline.file), pipeline.camera).camera
        if camera.mount is None and not camera.told:
            raise InputError(
                f"--robot, of {pipeline.file}",
                found="no camera.mount",
                expected="where the camera is on the robot",
                fix="Set camera.mount (docs/ros2.md), or camera.moving or camera.tf for one that moves.",
            )
    return pipeline.endpoints


def _messages_here(
    arguments: argparse.Namespace, stopping: Callable[[], bool], check: _ObjectCheck
) -> Iterator[Message]:
    import zenoh

    from huepose_protos.client import Reader
    from huepose_protos.messages import HealthMessage

    wait_for_pipeline(arguments, stopping)
    pipeline, said, warned = chosen(arguments), "", set[str]()
    key, health = pipeline.key(arguments.key), pipeline.key("health/**")
    asks_for_health = zenoh.KeyExpr(key).intersects(zenoh.KeyExpr(health))
    beside = [*([] if asks_for_health else [health]), *map(pipeline.key, check.keys)]
    say_at, heard = time.monotonic() + SAY_WAITING_AFTER_S, False
    with Reader(pipeline.endpoints, key, *beside) as reader:
        while not stopping() and not _is_over(reader):
            message = reader.next(0.1)
            if isinstance(message, HealthMessage):
                _warn(message, warned)
                message = message if asks_for_health else None
            if message is not None and not check.consumes(message):
                # Poses come with every frame, messages of other keys perhaps seldom.
                say_at = time.monotonic() + SAY_WAITING_AFTER_S if "/pose/" in key else float("inf")
                said, heard = "", True
                yield message
            elif time.monotonic() > say_at:
                say_at = time.monotonic() + SAY_WAITING_AFTER_S
                before, said = said, _silence(reader, pipeline, key, heard)
                if said != before:
                    say(said)
        if _is_over(reader):
            say(f"{pipeline.name} has ended")


def _warn(health: HealthMessage, warned: set[str]) -> None:
    """Print each warning of a worker once: the poses that are printed may be wrong because of it. A warning
    in which only numbers have changed is the same one."""
    for text in health.warnings:
        kind = f"{health.worker}: {_NUMBER.sub('0', text)}"
        if kind not in warned:
            warned.add(kind)
            say(f"{health.worker}: {text}")


_SHOW_ONLY = ("gateway", "viewer", "ros2")
"""Workers that poses do not depend on here."""


def _silence(reader: Reader, pipeline: Pipeline, key: str, heard: bool = False) -> str:
    """Why nothing comes, in words. heard: whether something came before."""
    from huepose_protos.keys import last

    if not reader.seen:
        return f"waiting for a pipeline: {pipeline.absence}"
    what = f"nothing is published on {key} yet"
    if "/pose/" in key and pipeline.elsewhere:
        return pipeline.elsewhere
    if "/pose/" in key:
        there, needed = {last(live) for live in list(reader.live)}, pipeline.workers or ("tracker",)
        away = [] if pipeline.played else [w for w in needed if w not in there and w not in _SHOW_ONLY]
        if away:
            return f"the pipeline runs without {', '.join(away)}: starting, or ended; its log says which"
        what = "no object has been found yet" if key.endswith(_POSES) else what
        what = f"no pose has come for {SAY_WAITING_AFTER_S:.0f} s" if heard else what
    elif key.endswith("/truth"):
        what = f"nothing is published on {key}: it needs `camera.truth: true`, and a source with ground truth"
    return f"the pipeline runs, but {what}; `huepose status` shows its state"


def _is_over(reader: Reader) -> bool:
    """Whether the pipeline was there, and has been gone for _GONE_AFTER_S."""
    if not reader.seen or reader.live or reader.gone_since is None:
        return False
    return reader.pending == 0 and time.monotonic() - reader.gone_since >= _GONE_AFTER_S


def _print(message: Message, as_json: bool) -> None:
    from huepose_protos import to_json
    from huepose_protos.messages import PoseMessage

    if as_json or not isinstance(message, PoseMessage):
        print(to_json(message), flush=True)
        return
    pose, where = message, "no pose"
    if pose.translation is not None and pose.quaternion is not None:
        place, turn = (
            " ".join(f"{x:+.4f}" for x in values) for values in (pose.translation, pose.quaternion)
        )
        where = f"{place} m   {turn}"
    who = f"{pose.frame_id:6d} {pose.object}/{pose.instance:<3d} {pose.state:9s}"
    print(f"{who} {pose.quality:.2f}  {where}  {pose.age_ms:.0f} ms  {pose.reason}".rstrip(), flush=True)

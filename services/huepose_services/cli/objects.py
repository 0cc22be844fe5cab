"""`huepose objects`: choose what a running pipeline on this machine searches for."""

from __future__ import annotations

import argparse
import time
from typing import TYPE_CHECKING, Any

from huepose.support.errors import InputError
from huepose_services.cli.options import (
    add_box,
    add_choice,
    add_json,
    chosen,
    print_result,
    say,
    say_if_unknown,
)

if TYPE_CHECKING:
    from huepose_protos.messages import ControlReply, ControlRequest
    from huepose_services.runtime.running import Pipeline

_CONNECT_WITHIN_S, _ANSWER_WITHIN_S = 3.0, 5.0


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser("objects", help="list, add, remove or reset objects of a running pipeline")
    actions = parser.add_subparsers(dest="action", required=True, metavar="ACTION")
    for action, text in (
        ("list", "the objects that are searched for"),
        ("add", "search for one more object that has a reference model"),
        ("remove", "no longer search for an object"),
        ("reset", "forget the pose of an object, and search for it again"),
    ):
        one = actions.add_parser(action, help=text)
        if action != "list":
            one.add_argument("name", metavar="NAME", help="the name of its reference model")
        if action in ("add", "reset"):
            add_box(one, "its box in the image, in pixels")
        if action == "add":
            one.add_argument(
                *("--max-instances", "--instances"),
                dest="instances",
                type=int,
                default=1,
                metavar="N",
                help="largest number of instances (1)",
            )
        add_json(one)
        add_choice(one)
        one.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Send the request to the pipeline, and print its answer."""
    import msgspec

    from huepose_protos.messages import ControlRequest

    box = getattr(arguments, "box", None)
    if box is not None:
        from huepose.geometry.box import given_box

        given_box(box)  # the pipeline, which knows the image size, checks it again
    message = {
        "publish_ns": time.monotonic_ns(),
        "action": arguments.action,
        "object": getattr(arguments, "name", None),
        "max_instances": getattr(arguments, "instances", 1),
        "box": None if box is None else tuple(box),
    }
    try:
        request = msgspec.convert(message, ControlRequest)
    except msgspec.ValidationError as error:
        raise _not_asked(arguments, of_number="max_instances" in str(error)) from error
    pipeline = chosen(arguments)
    say_if_unknown(pipeline)
    reply = None if pipeline.played or pipeline.elsewhere else ask(pipeline, request)
    if reply is None:
        say(f"huepose objects: {_no_answer(pipeline)}")
        return 1
    if not reply.done:
        say(f"huepose objects {arguments.action}: {reply.text}")
        return 2
    summary = _listed(reply) if arguments.action == "list" else reply.text
    print_result(arguments, msgspec.to_builtins(reply.objects), summary)
    return 0


def _no_answer(pipeline: Pipeline) -> str:
    """Why the pipeline does not answer."""
    if pipeline.elsewhere:
        return pipeline.elsewhere
    if pipeline.played or not pipeline.noted:
        return pipeline.absence
    if "reinit" not in pipeline.workers:
        return f"{pipeline.name} has no worker reinit, which keeps the list of objects ({pipeline.file})"
    return (
        f"the worker reinit of {pipeline.name} does not answer: it is starting or stopping, or has ended; "
        f"the log says which ({pipeline.file})"
    )


def _not_asked(arguments: argparse.Namespace, of_number: bool) -> InputError:
    """The error of an invalid request. of_number: the number of instances is wrong, else the name is."""
    if of_number:
        return InputError("--max-instances", found=str(arguments.instances), expected="1 to 64")
    name, slash, instance = arguments.name.partition("/")
    return InputError(
        arguments.action,
        found=arguments.name,
        expected="a name of 1 to 64 characters of a-z, 0-9, _ and -",
        fix=f"Name the object without /{instance}: {name}." if slash and instance.isdigit() else "",
    )


def ask(pipeline: Pipeline, request: ControlRequest) -> ControlReply | None:
    """The answer of the pipeline's worker `reinit`; None if it does not answer in time."""
    from huepose_protos import decode, encode
    from huepose_protos.messages import ControlReply
    from huepose_services.runtime.config import WORKERS
    from huepose_services.runtime.session import open_reader_session

    with open_reader_session([pipeline.endpoints[WORKERS.index("reinit")]]) as session:
        until = time.monotonic() + _CONNECT_WITHIN_S
        while time.monotonic() < until:
            # The link is up a moment after the session opens; until then nobody answers.
            for reply in session.get(
                pipeline.key("control"), payload=encode(request), timeout=_ANSWER_WITHIN_S
            ):
                if reply.ok is not None:
                    return decode(reply.ok.payload.to_bytes(), ControlReply)
            time.sleep(0.05)
    return None


def _listed(reply: ControlReply) -> str:
    lines = []
    for entry in reply.objects:
        found = entry.max_instances - entry.searching
        lines.append(f"{entry.object:32s} {found} of {entry.max_instances} found  {entry.reason}".rstrip())
    return "\n".join(lines) or "no object is searched for"

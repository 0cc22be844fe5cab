"""`huepose estimate`: the poses in one frame."""

from __future__ import annotations

import argparse
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from huepose.believe.state import State
from huepose.support.errors import InputError
from huepose.support.files import write_picture
from huepose_services.cli.options import (
    add_box,
    add_bundles,
    add_json,
    add_number,
    add_one_of,
    add_path,
    add_profile,
    add_several,
    from_one,
    print_result,
    say,
)

if TYPE_CHECKING:
    from huepose.estimation import Estimator, ObjectQuery, PoseEstimate
    from huepose.estimation.config import Method
    from huepose.estimation.estimator import Answered
    from huepose.geometry import RgbdFrame
    from huepose.geometry.arrays import Float64, UInt8
    from huepose.model import ReferenceModel
    from huepose.perception.types import Detection

THREADS = 2
"""Objects that are searched for at the same time, as many as a pipeline does by default."""

_ASKED = 5
"""Objects that are searched for with red and blue exchanged, at most."""


def add_parser(subparsers: Any) -> None:
    parser = subparsers.add_parser(
        "estimate",
        help="poses of known objects in one frame",
        description="Estimate poses in one RGB-D frame. The exit code is 0 also if nothing was found; --json "
        "has `found`.",
    )
    add_path(parser, "--color", "FILE", "colour image", required=True)
    add_path(parser, "--depth", "FILE", "16 bit depth image, aligned to colour", required=True)
    add_path(parser, "--camera", "FILE.json", "JSON with intrinsics and depth scale", required=True)
    add_bundles(parser)
    add_several(parser, "--object", "NAME", "objects to search for (all of the folder)", kind=str)
    more = "search for at most N instances of each object (1: only at the most likely place)"
    add_number(parser, "--instances", 1, more, kind=from_one)
    add_one_of(
        parser,
        "--method",
        ("full", "colorpair", "paper"),
        "full: the best; colorpair: only colour pairs; paper: the paper's method as it is (the "
        "last two need models that were onboarded with --paper)",
    )
    add_profile(parser)
    add_box(parser, "box of the object in pixels (default: the whole image is searched)")
    parser.add_argument(
        "--check-camera",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="check the camera: no pose is TRACKING if sizes do not fit the camera matrix, or depth "
        "is not aligned to colour",
    )
    add_json(parser, to_file=True)
    add_path(parser, "--image", "OUT.png", "write the image with the poses drawn on it")
    add_path(parser, "--explain", "DIR", "draw the steps that led to each pose")
    parser.set_defaults(call=call)


def call(arguments: argparse.Namespace) -> int:
    """Estimate and print the poses; write JSON and pictures if asked to."""
    from huepose.datasets.image_files import read_frame
    from huepose.estimation import Estimator, ObjectQuery
    from huepose.geometry.box import given_box
    from huepose.model import load_models
    from huepose.profiles import profile

    if arguments.instances > 1 and arguments.box is not None:
        raise InputError(
            "--instances",
            found="--box beside it, in which one instance of each object is estimated",
            expected="one of the two",
        )
    begun = time.monotonic()
    frame = read_frame(arguments.color, arguments.depth, arguments.camera)
    size = (frame.camera.width, frame.camera.height)
    box = None if arguments.box is None else given_box(arguments.box, size)
    models = load_models(arguments.bundles, arguments.object)
    names = list(dict.fromkeys(arguments.object or sorted(models)))
    settings = profile(arguments.profile)
    # In boxes of the detector, the presence decides what is found, not the quality.
    found_level = 0.0 if box is None else None
    estimator = Estimator(
        models, replace(settings.estimator, method=arguments.method, found_level=found_level)
    )
    if arguments.method != "full":
        estimator.prepare(names)  # raises for a model without the tables, whatever the frame shows
    proposed: list[Detection] = []
    pages: dict[str, UInt8] = {}
    if box is not None:
        queries = [ObjectQuery(name, box) for name in names]
    else:
        from huepose.perception.view_detector import ViewDetector

        least = settings.detector.min_score
        # For --explain also the places that are too unlikely for an estimate are kept.
        config = replace(settings.detector, min_score=0.0 if arguments.explain else least, threads=THREADS)
        detector = ViewDetector(models, config)
        most = arguments.instances
        proposed = detector.detect(frame, names, wanted=dict.fromkeys(names, most))
        queries = _queries(proposed, least)
    estimator.prepare([query.object for query in queries])
    estimator.estimate(frame, queries[:1])  # loads the kernels: `seconds` is the time of an estimate alone
    prepared = time.monotonic()
    explained = _each(estimator, frame, queries)
    answers = [answer for answer, _ in explained]
    if box is None:
        found = _searched_again(answers, names, most)
        while found:
            left = {name: most - len(mine) for name, mine in found.items()}
            more = detector.detect(frame, list(found), followed=found, wanted=left)
            queries = _queries(more, least, found)
            proposed, before = [*proposed, *more], len(answers)
            explained += _each(estimator, frame, queries)
            answers = [answer for answer, _ in explained]
            found = _searched_again(answers, found, most, before)
        answers, pages = _final_answers(arguments, frame, models, names, answers, proposed)
    original, answers = answers, [_doubted(frame, models[a.object], a, arguments.method) for a in answers]
    reasons = [answer.reason for answer in answers]
    loaded = "one model" if len(names) == 1 else f"{len(names)} models"
    say(
        f"{prepared - begun:.1f} s to load {loaded} and to find where objects may be, "
        f"{time.monotonic() - prepared:.1f} s to estimate poses"
    )
    against: list[str] = []
    if arguments.check_camera:
        against, of_objects = _against(frame, models, answers)
        why = {k: against[0] for k, a in enumerate(answers) if against and a.state == "TRACKING"} | of_objects
        answers = [
            replace(a, state=State.SUSPECT, reason=why[k]) if k in why else a for k, a in enumerate(answers)
        ]
    doubts = [*against, *_doubts(frame, models, answers)]
    for doubt in doubts:
        say(doubt)
    record = {"poses": [as_record(a) for a in answers], "doubts": doubts}
    print_result(arguments, record, in_words(answers))
    # The pictures come last: if the disk is full, the answer is already printed.
    if arguments.explain:
        for name, page in pages.items():
            write_picture(arguments.explain / f"{name}_places.png", page)
        _explain(arguments.explain, frame, models, original, reasons, explained)
    if arguments.image:
        from huepose_services.cli.explain import draw_answers

        write_picture(arguments.image, draw_answers(frame, models, answers))
    return 0


def _each(estimator: Estimator, frame: RgbdFrame, queries: Sequence[ObjectQuery]) -> list[Answered]:
    """The estimate and its explanation for each query, as if it were the only one."""
    return [estimator.explained(frame, [query])[0] for query in queries]


def _queries(
    places: Sequence[Detection], least: float, others: Mapping[str, Sequence[Float64]] | None = None
) -> list[ObjectQuery]:
    """Queries for the places with at least the score `least`. others: poses of the instances of each object
    that were found before."""
    from huepose.estimation import ObjectQuery

    known = others or {}
    return [
        ObjectQuery(place.object, place.box, searched=True, others=tuple(known.get(place.object, ())))
        for place in places
        if place.score >= least
    ]


def _searched_again(
    answers: Sequence[PoseEstimate], names: Iterable[str], most: int, before: int = 0
) -> dict[str, list[Float64]]:
    """The objects that are searched for once more, each with the poses found so far: those of which the
    answers from `before` on found an instance, and all answers together fewer than `most`."""
    from huepose.estimation.accepted import accepted_answers

    standing = accepted_answers(answers)
    new = {a.object for a in standing if any(a is one for one in answers[before:])}
    poses: dict[str, list[Float64]] = {name: [] for name in names if name in new}
    for answer in standing:
        if answer.object in poses and answer.T_cam_obj is not None:
            poses[answer.object].append(answer.T_cam_obj)
    return {name: mine for name, mine in poses.items() if len(mine) < most}


def _against(
    frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: list[PoseEstimate]
) -> tuple[list[str], dict[int, str]]:
    """Reasons against all poses of a frame: objects look larger or smaller than their depth says, or depth
    is far from aligned to colour. If there are none, reasons against single answers, by index."""
    from huepose.estimation.apparent_size import doubted_in
    from huepose.estimation.frame_offset import frame_offset

    offset = frame_offset(frame)
    if offset is not None:  # then the apparent sizes say nothing
        return [offset.said()], {}
    size, objects = doubted_in(frame, models, answers)
    if size is not None:
        return [size.said(frame.camera)], {}
    return [], {k: one.said_of_one() for k, one in objects.items()}


def _doubts(frame: RgbdFrame, models: Mapping[str, ReferenceModel], answers: list[PoseEstimate]) -> list[str]:
    """What else may be wrong with the frame itself, judged by the answers."""
    from huepose.estimation.depth_offset import depth_offset
    from huepose.geometry.image_faults import camera_doubted, depth_doubted
    from huepose.perception.exchanged import order_of_channels
    from huepose.perception.view_detector import ViewDetector

    out = [camera_doubted(frame.camera)]
    if not any(answer.found for answer in answers):
        out.append(depth_doubted(frame))
    if not any(answer.state == "TRACKING" for answer in answers):
        names = list(dict.fromkeys(answer.object for answer in answers))[:_ASKED]
        out.append(order_of_channels(frame, ViewDetector(models), names).exchanged or None)
    sure = [a for a in answers if a.state == "TRACKING"]
    placed = [(models[a.object], a.T_cam_obj) for a in sure if a.T_cam_obj is not None]
    offset = depth_offset(frame, placed)
    if offset is not None and offset.clear:
        out += [offset.said()]
    return [text for text in out if text is not None]


def _explain(
    folder: Path,
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    answers: Sequence[PoseEstimate],
    reasons: Sequence[str],
    explained: Sequence[Answered],
) -> None:
    """Write the explanation of each answer; for an object that was not found, of its most probable pose.
    reasons: why each answer has no pose, or is `SUSPECT`."""
    from huepose_services.cli.explain import SURE, write_explanation

    written: Counter[str] = Counter()
    for answer, reason in zip(answers, reasons, strict=True):
        of_it = [(a, why) for a, why in explained if a is answer]
        best = of_it or [(a, why) for a, why in explained if a.object == answer.object]
        if not best:
            continue
        written[answer.object] += 1
        number = written[answer.object]
        name = answer.object if number == 1 else f"{answer.object}_{number}"
        likeliest = max(best, key=lambda one: one[0].chance)
        accepted = bool(of_it) and answer.found
        doubts = write_explanation(folder, name, frame, models[answer.object], *likeliest, accepted, reason)
        against = "; ".join(doubts) or reason or SURE
        say(f"{name}: {against}" if accepted else f"{name}, not found, at its most likely place: {against}")


def _doubted(frame: RgbdFrame, model: ReferenceModel, answer: PoseEstimate, method: Method) -> PoseEstimate:
    """The answer; if it is `SUSPECT`, with the reason."""
    from huepose.estimation.reasons import NO_PROBABILITY, only_orientation_in_doubt
    from huepose.judge.open_region import PreparedSurface
    from huepose.tracking.types import Doubt
    from huepose_services.doubts import why_doubted

    if answer.state != "SUSPECT":
        return answer
    if answer.terms is None:
        return replace(answer, reason=NO_PROBABILITY)
    turned = Doubt.TURN if only_orientation_in_doubt(answer, method) else None
    return replace(answer, reason=why_doubted(PreparedSurface.of(model), frame, answer.T_cam_obj, turned))


def _final_answers(
    arguments: argparse.Namespace,
    frame: RgbdFrame,
    models: Mapping[str, ReferenceModel],
    names: list[str],
    answers: list[PoseEstimate],
    proposed: list[Detection],
) -> tuple[list[PoseEstimate], dict[str, UInt8]]:
    """The accepted poses at the proposed places (`accepted_answers`); for an object without any, an answer
    that says why it was not found. Also the pages of --explain about such objects, by name."""
    from huepose.estimation.accepted import accepted_answers, why_none_accepted
    from huepose.estimation.present import PresenceIn
    from huepose.estimation.types import PoseEstimate
    from huepose.geometry.image_faults import bad_image

    poses = accepted_answers(answers)
    advise = not any(pose.state == "TRACKING" for pose in poses)
    presence = None
    out: list[PoseEstimate] = []
    pages: dict[str, UInt8] = {}
    for name in names:
        standing = [pose for pose in poses if pose.object == name][: arguments.instances]
        if standing:
            out += standing
            continue
        presence = presence or PresenceIn(frame, models, arguments.method)
        mine = [a for a in answers if a.object == name]
        placed = [(name, a.T_cam_obj) for a in mine if a.T_cam_obj is not None]
        doubts = iter([doubt for _, doubt in presence.places(placed)])
        said = ["" if a.T_cam_obj is None else next(doubts) for a in mine]
        why = bad_image(frame, models[name].diameter_m) or why_none_accepted(name, mine, said, advise)
        out.append(PoseEstimate(name, reason=why))
        if arguments.explain:
            from huepose_services.cli.explain import draw_places

            tried = [
                (a.T_cam_obj, a.chance, doubt)
                for a, doubt in zip(mine, said, strict=True)
                if a.T_cam_obj is not None
            ]
            if not tried:
                best = [p.T_cam_obj for p in proposed if p.object == name and p.T_cam_obj is not None]
                seen = presence.places([(name, T) for T in best], refined=False)
                tried = [(T, *x) for T, x in zip(best, seen, strict=True)]
            tried.sort(key=lambda place: -place[1])
            pages[name] = draw_places(frame, models[name], why, tried)
    return out, pages


def in_words(answers: Sequence[PoseEstimate]) -> str:
    """A line for each pose: state, quality, position of the mesh's origin; below it the reason if it is
    `SUSPECT`. Then the objects that were not found, grouped by reason."""
    lines, missing = [], dict[str, list[str]]()
    for answer in answers:
        if answer.T_cam_obj is None:
            missing.setdefault(answer.reason, []).append(answer.object)
            continue
        at = " ".join(f"{x:+.3f}" for x in answer.T_cam_obj[:3, 3])
        pose = f"{answer.state:9s} quality {answer.quality:.2f}  {at} m from the camera"
        lines.append(f"{answer.object:24s} {pose}  {1000 * answer.seconds:.0f} ms")
        lines += [f"    {answer.reason}"] if answer.reason else []
    for reason, names in missing.items():
        lines.append(f"not found: {', '.join(names)}")
        lines += [f"    {reason}"] if reason else []
    return "\n".join(lines)


def as_record(answer: PoseEstimate) -> dict[str, Any]:
    """An estimate as in the JSON output: metres, T_cam_obj as 4x4, box as x y w h; reason: why nothing was
    found or why it is `SUSPECT`, else None."""
    return {
        "object": answer.object,
        "found": answer.found,
        "reason": answer.reason or None,
        "T_cam_obj": None if answer.T_cam_obj is None else answer.T_cam_obj.tolist(),
        "quality": answer.quality,
        "covariance": None if answer.covariance is None else answer.covariance.tolist(),
        "state": answer.state,
        "box": None if answer.box is None else [float(x) for x in answer.box],
        "seconds": answer.seconds,
    }

"""`huepose eval poses`: score the poses that a live run published."""

from __future__ import annotations

import argparse
from typing import Any

from huepose.evaluation.poses_protocol import evaluate_poses, read_messages
from huepose.evaluation.result_files import origin, write_json
from huepose.evaluation.targets import Targets
from huepose.support.words import known
from huepose_services.cli.evaluate_scenes import figure_table, open_scenes, states_line


def call(arguments: argparse.Namespace) -> int:
    """Score, print a table, write the results."""
    messages = read_messages(arguments.poses)
    fast_ycb = [arguments.fast_ycb] if arguments.fast_ycb else None
    bop = [arguments.bop] if arguments.bop else None
    (scene,), models = open_scenes(fast_ycb, bop, arguments.bundles)
    record = evaluate_poses(messages, scene, Targets(models)).as_json()
    print(_report(record["summary"]))
    write_json(arguments.json, record | {"origin": origin()})
    return 0


def _report(summary: dict[str, Any]) -> str:
    return "\n".join(
        [
            *_left_out(summary),
            figure_table("scene", summary["sequences"], {"instances": "n"}),
            states_line(summary),
            f"poses for {known(summary['poses_for_frames'], unit=' %')} of frames, "
            f"{known(summary['fps'])} frames/s, "
            f"capture to pose {summary['latency_ms_p50']:.1f} ms (p99 {summary['latency_ms_p99']:.1f} ms)",
        ]
    )


def _left_out(summary: dict[str, Any]) -> list[str]:
    """A sentence about messages that are not scored; empty if all are."""
    early, given = summary["messages_before_scene"], summary["messages"]
    counted = summary["messages_of_first_pass"] - early
    if counted == given:
        return []
    if early:  # a played scene begins with its first image, so the scene given is a part
        return [f"the scene is only a part of what was played: {counted} of {given} messages belong to it"]
    return [f"only the first pass of the scene counts: {counted} of {given} messages belong to it"]

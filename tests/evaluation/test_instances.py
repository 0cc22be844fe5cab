"""Which published pose is compared with which label."""

from __future__ import annotations

import numpy as np

from huepose.evaluation.instances import PublishedPose, instance_counts, match, places
from huepose.evaluation.targets import Targets

from .conftest import MemoryScene, pose_at, truth

LEFT, RIGHT = pose_at(-0.1), pose_at(0.1)


def published(track: int, T: np.ndarray | None, name: str = "box", state: str = "TRACKING") -> PublishedPose:
    return PublishedPose(name, track, T, state if T is not None else "LOST", 0.9)


def tracks(chosen) -> list[int | None]:
    return [None if pose is None else pose.track for pose in chosen]


def test_an_object_has_as_many_instances_as_labels_in_one_frame_at_most(models) -> None:
    scene = MemoryScene(
        "s",
        {
            0: (truth(0, 5, LEFT), truth(1, 16, LEFT)),
            1: (truth(0, 5, LEFT), truth(1, 5, RIGHT)),
            2: (truth(0, 7, LEFT),),
        },
    )
    assert instance_counts(scene, scene.image_ids, Targets(models)) == {"box": 2, "brick": 1}
    assert instance_counts(scene, [0], Targets(models, [7])) == {}


def test_poses_are_matched_jointly_to_the_nearest_labels(models) -> None:
    wanted = places((truth(0, 5, LEFT), truth(1, 5, RIGHT)), Targets(models), {"box": 2})
    chosen, phantoms = match(wanted, [published(4, pose_at(0.12)), published(9, pose_at(-0.02))])
    assert tracks(chosen) == [9, 4]
    assert phantoms == []


def test_a_track_without_a_pose_is_matched_to_the_remaining_label(models) -> None:
    wanted = places((truth(0, 5, LEFT), truth(1, 5, RIGHT)), Targets(models), {"box": 2})
    chosen, _ = match(wanted, [published(1, None), published(2, LEFT)])
    assert tracks(chosen) == [2, 1]


def test_an_unlabelled_pose_takes_an_absent_instance_and_a_further_one_is_a_phantom(models) -> None:
    wanted = places((truth(0, 5, LEFT),), Targets(models), {"box": 1, "brick": 1})
    unlabelled = published(3, RIGHT)
    chosen, phantoms = match(wanted, [published(1, LEFT), unlabelled, published(0, LEFT, "brick")])
    assert tracks(chosen) == [1, 0]
    assert wanted[1].truth is None
    assert phantoms == [unlabelled]


def test_poses_are_matched_to_labels_of_their_object_only(models) -> None:
    wanted = places((truth(0, 5, LEFT), truth(1, 7, RIGHT)), Targets(models), {"box": 1, "brick": 1})
    chosen, phantoms = match(wanted, [published(0, RIGHT), published(0, LEFT, "brick")])
    assert [pose.object for pose in chosen] == ["box", "brick"]
    assert phantoms == []

"""Hand-eye calibration: known answers, noise, and motions that do not determine the mount."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from huepose.geometry import hand_eye, hand_eye_doubts, se3
from huepose.geometry.hand_eye_certainty import certainty
from huepose.support.errors import InputError
from huepose_services.cli.main import main
from huepose_services.runtime.config_file import parse_all

X = se3.make(Rotation.from_euler("xyz", [20, -130, 75], degrees=True).as_matrix(), np.array([0.4, -0.2, 0.9]))
Y = se3.make(
    Rotation.from_euler("xyz", [-80, 10, 30], degrees=True).as_matrix(), np.array([0.02, 0.05, 0.12])
)


def measured(
    count: int, noise: float = 0.0, axis: np.ndarray | None = None, seed: int = 3, share: float = 2.0
) -> tuple[np.ndarray, np.ndarray]:
    """A and B of a camera X and an object Y. noise: standard deviation of the
    shift in metres; that of the rotation, in radians, is `share` times the number."""
    rng = np.random.default_rng(seed)
    A, B = [], []
    for _ in range(count):
        turn = rng.uniform(-0.8, 0.8) * axis if axis is not None else rng.uniform(-0.8, 0.8, 3)
        a = se3.make(se3.rotation_exp(turn), rng.uniform(-0.3, 0.3, 3))
        b = se3.inverse(a @ X) @ Y
        A.append(a)
        B.append(se3.perturb(b, rng.normal(0.0, noise, 6) * np.repeat([1.0, share], 3)))
    return np.array(A), np.array(B)


def test_without_noise_the_answer_is_exact() -> None:
    found = hand_eye.solve(*measured(6))
    assert np.allclose(found.X, X, atol=1e-7)
    assert np.allclose(found.Y, Y, atol=1e-7)
    assert found.shift_m.max() < 1e-7


def test_with_noise_it_is_better_than_one_measurement() -> None:
    found = hand_eye.solve(*measured(20, 0.002))
    assert np.linalg.norm(found.X[:3, 3] - X[:3, 3]) < 0.004
    assert np.degrees(se3.rotation_angle(found.X[:3, :3], X[:3, :3])) < 0.3
    assert 0.001 < np.median(found.shift_m) < 0.006


def test_an_outlier_is_found_and_has_little_effect() -> None:
    A, B = measured(12, 0.0005)
    B[4] = se3.perturb(B[4], np.array([0.1, 0.0, 0.0, 0.0, 0.4, 0.0]))
    found = hand_eye.solve(A, B)
    assert int(np.argmax(found.shift_m)) == 4
    assert np.linalg.norm(found.X[:3, 3] - X[:3, 3]) < 0.02


def test_motions_that_do_not_determine_the_mount_are_refused() -> None:
    with pytest.raises(InputError, match="one axis"):
        hand_eye.solve(*measured(8, axis=np.array([0.0, 0.0, 1.0])))
    A, B = measured(8)
    A[:, :3, :3] = np.eye(3)
    with pytest.raises(InputError, match=r"found almost no rotation of the hand \(0\.0 degrees\); expected"):
        hand_eye.solve(A, B)
    with pytest.raises(InputError, match="3 measurements"):
        hand_eye.solve(*measured(3))
    with pytest.raises(InputError, match="found 1 measurement;"):
        hand_eye.solve(*measured(1))


def test_poses_without_positions_are_refused() -> None:
    A, B = measured(8)
    B[:, :3, 3] = 0.0
    with pytest.raises(InputError, match="an object in the centre of the camera"):
        hand_eye.solve(A, B)


def turned(turns: list[np.ndarray], seed: int) -> tuple[np.ndarray, np.ndarray]:
    """A and B with these rotation vectors of the hand, and errors of 2 mm and 0.5 degrees."""
    rng = np.random.default_rng(seed)
    A = np.array([se3.make(se3.rotation_exp(turn), rng.uniform(-0.1, 0.1, 3)) for turn in turns])
    errors = rng.normal(0.0, 1.0, (len(A), 6)) * [0.002, 0.002, 0.002, *np.radians([0.5, 0.5, 0.5])]
    return A, np.array([se3.perturb(se3.inverse(a @ X) @ Y, e) for a, e in zip(A, errors, strict=True)])


@pytest.mark.parametrize("seed", range(8))
def test_a_hand_that_is_rotated_in_right_angles_gives_the_mount(seed: int) -> None:
    # Many motions are half turns, whose axis has no certain sign.
    found = hand_eye.solve(*turned([k * np.pi / 2 * axis for axis in np.eye(3) for k in (1, 2, 3)], seed))
    assert np.linalg.norm(found.X[:3, 3] - X[:3, 3]) < 0.01
    assert np.degrees(se3.rotation_angle(found.X, X)) < 1.0
    assert found.forms_apart[1] < np.radians(3.0)


def test_half_turns_do_not_replace_the_second_axis() -> None:
    about_z = [np.radians(20 * k) * np.eye(3)[2] for k in range(4)]
    half = se3.rotation_exp(np.pi * np.eye(3)[0])
    flipped = [se3.rotation_log(half @ se3.rotation_exp(turn)) for turn in about_z]
    with pytest.raises(InputError, match=r"one axis only, besides half turns; expected .* 20 to 150 degrees"):
        hand_eye.solve(*turned(about_z + flipped, 0))


def test_an_invalid_pose_is_refused() -> None:
    A, B = np.tile(np.eye(4), (2, 12, 1, 1))
    B[3, 0, 3] = np.nan
    with pytest.raises(InputError, match="numbers that are not finite"):
        hand_eye.solve(A, B)


def test_the_reported_error_is_that_of_many_runs() -> None:
    shifts, reported = [], []
    for seed in range(40):
        A, B = measured(12, 0.001, seed=seed)
        found = hand_eye.solve(A, B)
        shifts.append(found.X[:3, 3] - X[:3, 3])
        reported.append(certainty(A, B, found).shift_m)
    assert np.median(reported) == pytest.approx(
        np.sqrt(np.linalg.eigvalsh(np.cov(np.array(shifts).T))[-1]), rel=0.4
    )


@pytest.mark.parametrize("share", [0.5, 5.0])
def test_the_reported_error_holds_where_rotations_are_more_or_less_exact_than_positions(share: float) -> None:
    errors, reported = [], []
    for seed in range(60):
        A, B = measured(12, 0.001, seed=seed, share=share)
        found = hand_eye.solve(A, B)
        errors.append(se3.rotation_log(X[:3, :3].T @ found.X[:3, :3]))
        reported.append(certainty(A, B, found).turn_rad)
    worst = np.sqrt(np.linalg.eigvalsh(np.cov(np.array(errors).T))[-1])
    assert 0.95 < np.sqrt(np.mean(np.square(reported))) / worst < 1.25


def test_few_poses_and_small_rotations_are_less_certain() -> None:
    def of(count: int, share: float = 1.0) -> tuple[float, int | None]:
        A, _ = measured(count)
        A = np.array([se3.make(se3.rotation_exp(share * se3.rotation_log(a[:3, :3])), a[:3, 3]) for a in A])
        B = np.array([se3.inverse(a @ X) @ Y for a in A])
        sure = certainty(A, B, hand_eye.solve(A, B))
        assert sure.well == (sure.more == 0) == (max(sure.shift_ratio, sure.turn_ratio) <= 1.0)
        return sure.shift_ratio, sure.more

    assert of(20)[0] < of(20, 0.6)[0] < of(20, 0.4)[0]  # an error grows as rotations get smaller
    assert of(20)[1] == 0
    few, more = of(4)
    assert few > 1.0
    assert more in range(2, 21)


def test_the_axis_about_which_the_hand_hardly_rotated_is_named() -> None:
    A, _ = measured(12)
    flat = [se3.make(se3.rotation_exp(se3.rotation_log(a[:3, :3]) * [1.0, 1.0, 0.1]), a[:3, 3]) for a in A]
    A = np.array(flat)
    B = np.array([se3.inverse(a @ X) @ Y for a in A])
    sure = certainty(A, B, hand_eye.solve(A, B))
    assert abs(sure.axis[2]) > 0.97
    assert sure.turned_rad < 0.3 * sure.most_rad


def rows(poses: np.ndarray) -> str:
    out = ["frame,object,x,y,z,qx,qy,qz,qw"]
    for k, T in enumerate(poses):
        values = [*T[:3, 3], *se3.quaternion_from_rotation(T[:3, :3])]
        out.append(f"{k},thing," + ",".join(f"{v:.9f}" for v in values))
    return "\n".join(out) + "\n"


def files(folder: Path, hand: str, seen: str) -> list[str]:
    """Options with the rows of the hand's poses and of the object's, in files of a folder."""
    (folder / "hand.csv").write_text(hand)
    (folder / "object.csv").write_text(seen)
    return ["--object", str(folder / "object.csv"), "--hand", str(folder / "hand.csv")]


def test_the_command_takes_no_parent_frame_that_a_mount_cannot_have(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(8)
    options = [*files(tmp_path, rows(A), rows(B)), "--camera", "on-hand", "--parent", "tool 0"]
    assert main(["calibrate", "hand-eye", *options]) == 2
    assert "--parent: found 'tool 0'; expected 1 to 64 characters, no blank" in capsys.readouterr().err


@pytest.mark.parametrize("camera", ["fixed", "on-hand"])
def test_the_command_says_what_to_configure(
    tmp_path: Path, camera: str, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(8)
    hand = np.array([se3.inverse(a) for a in A]) if camera == "fixed" else A
    out = tmp_path / "out.json"
    options = files(tmp_path, rows(hand), rows(B))
    outputs = ["--json", str(out), "--image", str(tmp_path / "left.png")]
    assert main(["calibrate", "hand-eye", *options, "--camera", camera, *outputs]) == 0
    answer = json.loads(out.read_text())
    mount, facts = answer["mount"], answer["certainty"]
    assert facts["closed_forms_apart_mm"] < 0.01
    assert facts["closed_forms_apart_deg"] < 0.01
    assert mount["parent"] == ("base_link" if camera == "fixed" else "tool0")
    assert np.allclose(mount["translation"], X[:3, 3], atol=1e-5)
    assert np.allclose(se3.rotation_from_quaternion(np.array(mount["quaternion"])), X[:3, :3], atol=1e-4)
    said = capsys.readouterr().out
    (line,) = (line for line in said.splitlines() if line.startswith("mount: {parent: "))
    (config,) = parse_all(f"camera: {{{line}}}", tmp_path / "pipeline.yaml")
    configured = config.camera.mount
    assert configured is not None
    assert (configured.parent, list(configured.translation)) == (mount["parent"], mount["translation"])
    assert "the methods of Park, Tsai and Daniilidis differ by 0.0 mm and 0.00 degrees at most" in said
    assert (tmp_path / "left.png").stat().st_size > 1000


def test_the_poses_of_several_objects_are_not_taken_together(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(8, 0.001)
    lines = rows(B).splitlines()
    of_mug = [f"{line.replace('thing', 'mug')},{instance}" for line in lines[1:] for instance in (0, 1)]
    others = [line.replace("thing", "jar") + ",0,1700000000.5,0.99" for line in lines[3:]]
    options = files(tmp_path, rows(A), "\n".join([lines[0], *of_mug, *others]) + "\n")
    line = ["calibrate", "hand-eye", *options, "--camera", "on-hand"]
    assert main(line) == 2
    assert "found poses of mug/0 (8), mug/1 (8), jar/0 (6)" in capsys.readouterr().err
    assert main([*line, "--name", "mug"]) == 2
    assert main([*line, "--name", "cup"]) == 2
    assert "no pose of cup" in capsys.readouterr().err
    assert main([*line, "--name", "jar", "--json"]) == 0
    left = json.loads(capsys.readouterr().out)["left"]
    assert left["poses"] == 6
    assert main([*line, "--name", "mug/1"]) == 0
    assert capsys.readouterr().out.count("residuals of 8 poses: median") == 1


def test_frame_numbers_that_begin_again_are_not_mixed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # The camera was opened again: its frames 0 to 9 come after other frames 0 to 5.
    A, B = measured(16)
    header, *later = rows(B[6:]).splitlines()
    earlier = rows(B[:6]).splitlines()[1:]
    options = files(tmp_path, rows(A[6:]), "\n".join([header, *earlier, *later]) + "\n")
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand"]) == 2
    assert "object.csv: found frame 0 in two places" in capsys.readouterr().err
    both = "\n".join([header, *rows(A[:6]).splitlines()[1:], *rows(A[6:]).splitlines()[1:]]) + "\n"
    options = files(tmp_path, both, "\n".join([header, *earlier]) + "\n")
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand"]) == 2
    assert "hand.csv: found frame 0 in two places" in capsys.readouterr().err
    hand = "\n".join([header, *rows(A[6:]).splitlines()[7:]]) + "\n"
    options = files(tmp_path, hand, "\n".join([header, *earlier, *later]) + "\n")
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand"]) == 0


def test_the_median_is_the_same_in_words_and_as_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(8, 0.002)
    options = files(tmp_path, rows(A), rows(B))
    out = tmp_path / "out.json"
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand", "--json", str(out)]) == 0
    shift = json.loads(out.read_text())["left"]["shift_mm"]
    assert f"median {shift['median']:.1f} mm" in capsys.readouterr().out
    expected = 1e3 * np.median(hand_eye.solve(A, B).shift_m)
    assert shift["median"] == pytest.approx(expected, rel=1e-3)


def test_the_command_says_when_four_poses_are_too_few(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(4, 0.001)
    options = files(tmp_path, rows(A), rows(B))
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand"]) == 0
    said = capsys.readouterr().out
    assert "POORLY DETERMINED: the mount's position may be" in said
    assert "poses or more, rotated by 30 degrees" in said


def as_millimetres(hand: np.ndarray) -> np.ndarray:
    hand = hand.copy()
    hand[:, :3, 3] *= 1e3
    return hand


def as_w_first(hand: np.ndarray) -> np.ndarray:
    """The poses that a reader of x y z w gets from quaternions written as w x y z."""
    turns = [se3.rotation_from_quaternion(np.roll(quaternion(T), 1)) for T in hand]
    return np.array([se3.make(R, T[:3, 3]) for R, T in zip(turns, hand, strict=True)])


def quaternion(T: np.ndarray) -> np.ndarray:
    return se3.quaternion_from_rotation(T[:3, :3])


@pytest.mark.parametrize(
    ("wrong", "fixed", "meaning", "advice"),
    [
        (as_millimetres, True, ["millimetres"], "in metres (they seem to be millimetres)"),
        (as_w_first, True, ["quaternion order"], "as x y z w (they seem to be w x y z)"),
        (lambda hand: hand, False, ["camera"], "--camera fixed instead of on-hand"),
        (
            lambda hand: as_millimetres(as_w_first(hand)),
            True,
            ["millimetres", "quaternion order"],
            "in metres",
        ),
    ],
)
def test_poses_in_another_convention_give_no_mount_but_their_likely_convention(
    wrong, fixed: bool, meaning: list[str], advice: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(12, 0.001)
    options = files(tmp_path, rows(wrong(np.array([se3.inverse(a) for a in A]))), rows(B))
    camera, out = "fixed" if fixed else "on-hand", tmp_path / "out.json"
    assert main(["calibrate", "hand-eye", *options, "--camera", camera, "--json", str(out)]) == 1
    said = capsys.readouterr().out
    assert "THE POSES DO NOT FIT TOGETHER" in said
    assert advice in said
    assert "mount:" not in said
    answer = json.loads(out.read_text())
    assert answer["mount"] is None
    assert answer["certainty"] == {"well_determined": False, "would_fit_with": meaning}


def test_poses_of_other_frames_are_refused_without_an_invented_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    A, B = measured(12, 0.001)
    options = files(tmp_path, rows(A[::-1]), rows(B))
    assert main(["calibrate", "hand-eye", *options, "--camera", "on-hand"]) == 1
    said = capsys.readouterr().out
    assert "T_base_hand at the same frames" in said
    assert "They fit if" not in said


def test_noise_and_an_outlier_fit() -> None:
    A, B = measured(12, 0.004)
    B[4] = se3.perturb(B[4], np.array([0.0, 0.0, 0.0, 0.0, 3.0, 0.0]))
    assert hand_eye_doubts.fits(B, hand_eye.solve(A, B))


def test_the_two_files_exchanged_are_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Exchanged, they would fit too: the mount would be the inverse of the right one."""
    A, B = measured(8)
    first, *lines = rows(B).splitlines()
    seen = "\n".join([f"{first},instance,stamp,quality", *(f"{line},0,1.5,0.99" for line in lines)])
    options = files(tmp_path, seen, rows(np.array([se3.inverse(a) for a in A])))
    assert main(["calibrate", "hand-eye", *options, "--camera", "fixed"]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "hand.csv: found poses of an object" in said
    assert "Is this the file for --object?" in said


def test_exchanged_files_are_noticed_without_the_column_of_the_instance(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """An arm 0.4 to 0.6 m in front of its base, 0.1 to 0.4 m high, and a camera beside it that views it."""
    rng = np.random.default_rng(5)
    X = se3.make(np.array([[-1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, -1.0, 0.0]]), np.array([0.5, 1.0, 0.25]))
    hand = np.array(
        [
            se3.make(
                se3.rotation_exp(rng.uniform(-0.8, 0.8, 3)), rng.uniform([0.4, -0.2, 0.1], [0.6, 0.2, 0.4])
            )
            for _ in range(12)
        ]
    )
    seen = np.array([se3.inverse(X) @ T @ Y for T in hand])
    right, wrong = tmp_path / "right", tmp_path / "wrong"
    right.mkdir()
    wrong.mkdir()
    call = ["calibrate", "hand-eye", "--camera", "fixed"]
    assert main([*call, *files(right, rows(hand), rows(seen))]) == 0
    assert main([*call, *files(wrong, rows(seen), rows(hand))]) == 2
    assert "Are the files of --object and --hand exchanged?" in capsys.readouterr().err
    assert main([*call, *files(wrong, rows(seen), rows(seen))]) == 2
    assert "hand.csv: found the poses of --object" in capsys.readouterr().err

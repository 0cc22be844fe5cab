"""A mesh from a recording: rendered sequences of a rotating object, with exact ground truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from importlib import import_module
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from huepose.geometry import Box, Camera, Mesh, RgbdFrame, se3
from huepose.geometry.arrays import Float64, UInt8
from huepose.geometry.camera import depth_noise_m
from huepose.onboarding.from_video import Learned, Selection, learn
from huepose.onboarding.from_video.fusion import FEW_CELLS, Fused, fused, painted
from huepose.onboarding.from_video.registration import Edge, relaxed
from huepose.onboarding.from_video.selection import first_mask
from huepose.onboarding.from_video.views import View, votes
from huepose.propose import flow
from huepose.rendering import render
from huepose.scenes.motion import UP_ROOM, upright
from huepose.scenes.room import sheet, table_top
from huepose.support.errors import InputError
from tests.meshes import demo_objects

pytest.importorskip("open3d", reason="open3d is not installed")
LEARN = import_module("huepose.onboarding.from_video.learn")  # the package exports a function of this name
pytestmark = pytest.mark.timeout(400)  # the first test makes the mesh for all

CAMERA = Camera(330.0, 330.0, 159.5, 119.5, 320, 240)
MIDDLE_CAM = np.array([0.0, 0.0, 0.5])
BOX = demo_objects(0)["tea_box"]
FRAMES, STEP_DEG = 18, 7.5


@cache
def table() -> Mesh:
    return sheet(0.9, 0.8, table_top(np.random.default_rng(1)))


def pose(angle: float) -> Float64:
    return se3.make(upright(angle), MIDDLE_CAM)


def rendered(T_cam_obj: Float64, number: int, *, hand: tuple[Mesh, Float64] | None = None) -> RgbdFrame:
    ground = se3.make(upright(0.0), MIDDLE_CAM + float(BOX.vertices[:, 2].min()) * UP_ROOM)
    scene = [(BOX, T_cam_obj), (table(), ground)] + ([] if hand is None else [hand])
    seen = render(scene, CAMERA)
    noise = np.random.default_rng(number).normal(0, depth_noise_m(0.5), seen.depth.shape)
    depth = np.where(seen.depth > 0, seen.depth + noise, 0).astype(np.float32)
    return RgbdFrame(seen.color, depth, CAMERA, number, number * 33_000_000)


def box_of(T_cam_obj: Float64) -> Selection:
    box = Box.of_mask(render([(BOX, T_cam_obj)], CAMERA, color=False).depth > 0)
    assert box is not None
    return Selection(box.grown(0.08))


def off_m(points: Float64) -> Float64:
    """Distances of points (N, 3) from the box's surface."""
    half = np.ptp(BOX.vertices, axis=0) / 2
    q = np.abs(points - BOX.centre) - half
    outside = np.linalg.norm(np.maximum(q, 0), axis=1)
    return np.asarray(outside + np.abs(np.minimum(q.max(1), 0)))


@cache
def learned() -> Learned:
    poses = [pose(np.radians(STEP_DEG * k)) for k in range(FRAMES)]
    return learn((rendered(T, k) for k, T in enumerate(poses)), box_of(poses[0]))


def test_the_seen_surface_is_the_true_one() -> None:
    made = learned()
    T_true_made = se3.inverse(pose(np.radians(STEP_DEG * (FRAMES // 2)))) @ made.T_cam_obj[FRAMES // 2]
    off = off_m(se3.apply(T_true_made, made.mesh.vertices[made.seen]))
    assert off.mean() < 0.001
    assert np.percentile(off, 90) < 0.003
    assert np.abs(np.ptp(made.mesh.vertices, axis=0) - np.ptp(BOX.vertices, axis=0)).max() < 0.02
    assert 0.5 < made.surface < 0.9  # without the underside and the side that faced away


def test_the_origin_is_in_the_middle_and_z_points_up() -> None:
    vertices = learned().mesh.vertices
    assert np.allclose((vertices.min(0) + vertices.max(0)) / 2, 0.0, atol=1e-4)
    up = learned().T_cam_obj[0][:3, 2]
    assert np.degrees(np.arccos(up @ UP_ROOM)) < 2.0


def test_the_poses_follow_the_rotation() -> None:
    made = learned()
    assert len(made.T_cam_obj) == made.frames == FRAMES
    turned = [se3.rotation_angle(made.T_cam_obj[0][:3, :3], T[:3, :3]) for T in made.T_cam_obj.values()]
    assert np.allclose(np.degrees(turned), STEP_DEG * np.arange(FRAMES), atol=1.5)


def test_the_texture_is_in_the_right_place() -> None:
    made, number = learned(), FRAMES // 2
    now = render([(made.mesh, made.T_cam_obj[number])], CAMERA)
    true = render([(BOX, pose(np.radians(STEP_DEG * number)))], CAMERA)
    both = (now.depth > 0) & (true.depth > 0)
    difference = np.abs(now.color[both].astype(int) - true.color[both]).mean(1)
    assert np.median(difference) < 12
    assert both.sum() > 0.95 * (true.depth > 0).sum()


@pytest.mark.parametrize("how", ["box", "click"])
def test_the_first_mask_is_the_object_above_the_table(how: str) -> None:
    T = pose(0.4)
    true = render([(BOX, T)], CAMERA, color=False).depth > 0
    selection = box_of(T) if how == "box" else Selection(click=(160.0, 118.0))
    mask, _, ground = first_mask(rendered(T, 0), selection)
    assert (mask & true).sum() > 0.9 * true.sum()
    assert (mask & ~true).sum() < 0.02 * true.sum()
    assert ground is not None
    assert np.degrees(np.arccos(ground[:3] @ UP_ROOM)) < 1.0


def test_a_selection_of_the_table_or_without_depth_is_refused() -> None:
    frame = rendered(pose(0.0), 0)
    with pytest.raises(InputError, match=r"a surface over \d+ % of the image"):
        first_mask(frame, Selection(click=(40.0, 200.0)))
    blind = RgbdFrame(frame.color, np.zeros_like(frame.depth), CAMERA)
    with pytest.raises(InputError, match="no depth there"):
        first_mask(blind, box_of(pose(0.0)))


@pytest.mark.parametrize(
    ("selection", "given"),
    [
        (Selection(Box(700.0, 10.0, 60.0, 60.0)), "--box: found 700 10 60 60; expected X Y W H"),
        (Selection(click=(10.0, float(CAMERA.height))), f"--click 10 {CAMERA.height}: expected X Y"),
        (Selection(click=(-1.0, 10.0)), "--click -1 10: expected X Y"),
    ],
)
def test_a_selection_outside_the_image_is_refused_with_the_image_size(
    selection: Selection, given: str
) -> None:
    with pytest.raises(InputError) as error:
        first_mask(rendered(pose(0.0), 0), selection)
    assert str(error.value).startswith(given)
    assert f"in the image of {CAMERA.width} x {CAMERA.height}" in str(error.value)


def test_a_click_on_a_wall_is_refused() -> None:
    """An oblique wall that covers a third of the image and is as wide as it is far away."""
    depth = np.tile(1.0 / np.linspace(0.4, 2.0, CAMERA.height), (CAMERA.width, 1)).T.astype(np.float32)
    depth[:, 110:] = 0.0
    wall = RgbdFrame(np.full((*depth.shape, 3), 128, np.uint8), depth, CAMERA)
    with pytest.raises(InputError, match=r"a surface \d\.\d m across, \d\.\d m from the camera.*--box"):
        learn([wall, wall], Selection(click=(50.0, 120.0)))


def test_an_object_that_does_not_move_is_refused() -> None:
    with pytest.raises(InputError, match="rotated by less than 5 degrees"):
        learn((rendered(pose(0.0), k) for k in range(3)), box_of(pose(0.0)))


def test_an_object_that_leaves_the_image_is_refused_with_the_reason() -> None:
    gone = se3.make(np.eye(3), np.array([0, 0, 5.0]))
    frames = [rendered(pose(0.0), 0), *(rendered(gone, k) for k in range(1, 5))]
    with pytest.raises(InputError, match=r"tracked in only 1 of 5 frames; .*Turn it more slowly"):
        learn(frames, box_of(pose(0.0)))


def turning(count: int, step_deg: float = 6.0) -> list[RgbdFrame]:
    return [rendered(pose(np.radians(step_deg * k)), k) for k in range(count)]


def scaled(frame: RgbdFrame, factor: float) -> RgbdFrame:
    """The frame at another resolution of the camera."""
    camera = frame.camera.scaled(factor)
    size = (camera.width, camera.height)
    color = np.asarray(cv2.resize(frame.color, size, interpolation=cv2.INTER_AREA), np.uint8)
    depth = np.asarray(cv2.resize(frame.depth, size, interpolation=cv2.INTER_NEAREST), np.float32)
    return RgbdFrame(color, depth, camera, frame.frame_id, frame.stamp_ns)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_tracking_survives_a_change_of_image_size_without_flow_across_it(
    factor: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames, pairs = turning(4), []

    def compute(a: UInt8, b: UInt8, box: Box) -> flow.Flow | None:
        pairs.append((a.shape, b.shape))
        return flow.compute(a, b, box)

    monkeypatch.setattr("huepose.onboarding.from_video.registration.flow", SimpleNamespace(compute=compute))
    track = LEARN._Track.begun(frames[0], box_of(pose(0.0)))
    begun = track.T_cam_obj
    assert all(track.follow(frame) for frame in [frames[1], *(scaled(f, factor) for f in frames[2:])])
    assert len(pairs) == 2
    assert all(a == b for a, b in pairs)
    turned = se3.rotation_angle(begun[:3, :3], track.T_cam_obj[:3, :3])
    assert np.degrees(turned) == pytest.approx(18.0, abs=1.0)


def test_a_too_thin_object_is_refused_with_how_to_record_it() -> None:
    across = np.array([0.14, 0.004, 0.004]) / np.ptp(BOX.vertices, axis=0)
    pencil = replace(BOX, vertices=(BOX.vertices * across).astype(np.float32))
    T = se3.make(upright(0.0), MIDDLE_CAM)
    ground = se3.make(upright(0.0), MIDDLE_CAM - 0.02 * UP_ROOM)
    seen = render([(pencil, T), (table(), ground)], CAMERA)
    box = Box.of_mask(render([(pencil, T)], CAMERA, color=False).depth > 0)
    assert box is not None
    frame = RgbdFrame(seen.color, seen.depth, CAMERA)
    with pytest.raises(InputError, match=r"4 pixels thick at most.*Record it from a shorter distance"):
        learn([frame, frame], Selection(box.grown(0.08)))


@pytest.fixture
def coarse(monkeypatch: pytest.MonkeyPatch) -> None:
    """Surfaces of large triangles, without texture: for tests that look only at views and poses."""
    monkeypatch.setattr(LEARN, "fused", partial(fused, cells=FEW_CELLS))
    monkeypatch.setattr(LEARN, "painted", lambda *_: BOX)


@pytest.mark.usefixtures("coarse")
def test_a_view_that_shows_only_rims_is_not_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    view_at = LEARN.view_at

    def narrow(frame: RgbdFrame, *about: object) -> View:
        view = view_at(frame, *about)
        stripes = np.arange(len(view.mask))[:, None] % 4 > 0
        return replace(view, mask=view.mask & stripes) if frame.frame_id == 1 else view

    monkeypatch.setattr(LEARN, "view_at", narrow)
    monkeypatch.setattr(LEARN, "POLISHES", 1)
    made = learn(turning(3), box_of(pose(0.0)))
    assert (made.views, len(made.T_cam_obj)) == (2, 3)


@pytest.mark.usefixtures("coarse")
def test_poses_of_frames_move_with_their_views_when_a_loop_is_closed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Closing a loop moves earlier views; the mesh is made from the views at their final poses."""
    views: list[View] = []

    def closed(track: LEARN._Track) -> bool:
        if len(track.views) < 3:
            return False
        moves = [se3.make(upright_z(0.01 * k), np.zeros(3)) for k in range(len(track.views))]
        track.views = [view.at(view.T_cam_obj @ T) for view, T in zip(track.views, moves, strict=True)]
        return True

    def as_they_are(kept: Sequence[View], *_: object) -> list[View]:
        views.extend(kept)
        return views

    monkeypatch.setattr(LEARN._Track, "_close", closed)
    monkeypatch.setattr(LEARN, "_polished", as_they_are)
    made = learn(turning(3), box_of(pose(0.0)))
    T_old_new = se3.inverse(views[2].T_cam_obj) @ made.T_cam_obj[2]
    for number, view in enumerate(views):
        np.testing.assert_allclose(made.T_cam_obj[number], view.T_cam_obj @ T_old_new, atol=1e-9)


@pytest.mark.usefixtures("coarse")
def test_a_view_whose_mask_becomes_empty_leaves_the_other_poses_as_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    masks = LEARN.object_mask

    def emptied(part: RgbdFrame, *about: object) -> tuple[np.ndarray, np.ndarray]:
        mask, denied = masks(part, *about)
        return mask & (part.frame_id != 1), denied

    monkeypatch.setattr(LEARN, "object_mask", emptied)
    monkeypatch.setattr(LEARN, "POLISHES", 1)
    made = learn(turning(3), box_of(pose(0.0)))
    assert made.views == 2
    turned = [se3.rotation_angle(made.T_cam_obj[0][:3, :3], T[:3, :3]) for T in made.T_cam_obj.values()]
    assert np.allclose(np.degrees(turned), [0.0, 6.0, 12.0], atol=1.0)


def test_views_that_leave_no_surface_are_refused_with_how_to_record_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    views = [SimpleNamespace(mask=np.ones((4, 4), bool)) for _ in range(2)]
    monkeypatch.setattr(LEARN, "fused", lambda views: None)
    monkeypatch.setattr(LEARN, "_moved_to_fit", lambda view, *_: view)
    monkeypatch.setattr(LEARN, "_masked_by", lambda *_: SimpleNamespace(mask=np.zeros((4, 4), bool)))
    with pytest.raises(InputError, match=r"views that contradict each other.*Record it again"):
        LEARN._polished(views, 0.1, lambda step: None)


def test_a_finger_that_is_gone_later_is_a_free_space_violation() -> None:
    """Of two views, one shows the finger, the other shows free space there: one vote each."""
    T = pose(0.0)
    finger = sheet(0.02, 0.02, np.full((8, 8, 3), 180, np.uint8))
    at = se3.make(upright(0.0) @ se3.rotation_exp(np.array([np.pi / 2, 0, 0])), MIDDLE_CAM - [0, 0, 0.07])
    frame, free = rendered(T, 0, hand=(finger, at)), rendered(T, 1)
    everywhere, nowhere = np.ones(frame.depth.shape, bool), np.zeros(frame.depth.shape, bool)
    held, bare = (View(f, everywhere, nowhere, T, None) for f in (frame, free))
    place = se3.apply(se3.inverse(T), at[:3, 3][None])
    said = votes(place, [held, bare])
    assert (said.there[0], said.through[0], said.behind[0]) == (1, 1, 0)


def ring(count: int) -> list[View]:
    frame = rendered(pose(0.0), 0)
    mask = np.zeros(frame.depth.shape, bool)
    return [View(frame, mask, mask, pose(2 * np.pi * k / count), None) for k in range(count)]


def test_black_surface_stays_black() -> None:
    """Also where the camera gives 0 in all channels, which the texture has between its triangles, too."""
    color = np.zeros((240, 320, 3), np.uint8)
    color[:, 160:] = 200
    frame = RgbdFrame(color, np.full((240, 320), 0.5, np.float32), CAMERA)
    everywhere = np.ones(color.shape[:2], bool)
    view = View(frame, everywhere, ~everywhere, se3.make(np.eye(3), MIDDLE_CAM), None)
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(-0.1, 0.1, 9), np.linspace(-0.1, 0.1, 9)))
    a = np.array([9 * i + j for i in range(8) for j in range(8)])
    faces = np.concatenate([np.stack([a, a + 9, a + 1], 1), np.stack([a + 1, a + 9, a + 10], 1)])
    vertices = np.stack([x, y, np.zeros(81)], 1)
    shape = Fused(vertices, np.tile([0.0, 0.0, -1.0], (81, 1)), faces.astype(np.int32), np.ones(81, bool))
    seen = render([(painted(shape, [view]), view.T_cam_obj)], CAMERA).color
    assert seen[120, 110:140].max() == 0
    assert seen[120, 180:210].min() == 200


def test_loop_closure_distributes_the_drift() -> None:
    """Each step drifts by half a degree: before loop closure, the last of 12 views is off by 5.5 degrees."""
    views, drift = ring(12), np.radians(0.5)
    drifted = [v.at(v.T_cam_obj @ se3.make(upright_z(drift * k), np.zeros(3))) for k, v in enumerate(views)]
    edges = [Edge(k, k + 1, edge(drifted[k], drifted[k + 1]), False) for k in range(11)]
    closed = relaxed(drifted, [*edges, Edge(0, 11, edge(views[0], views[11]), True)], 0.09)
    assert off_deg(drifted[11], views[11]) > 5.4
    assert off_deg(closed[11], views[11]) < 0.6
    assert off_deg(closed[6], views[6]) < off_deg(drifted[6], views[6])


def test_a_wrong_loop_closure_is_rejected() -> None:
    views = ring(12)
    edges = [Edge(k, k + 1, edge(views[k], views[k + 1]), False) for k in range(11)]
    right = Edge(0, 11, edge(views[0], views[11]), True)
    wrong = Edge(1, 10, edge(views[1], views[6]), True)
    assert off_deg(relaxed(views, [*edges, right, wrong], 0.09)[10], views[10]) < 1.0


def upright_z(angle: float) -> Float64:
    return se3.rotation_exp(np.array([0.0, 0.0, angle]))


def edge(a: View, b: View) -> Float64:
    return np.asarray(b.T_cam_obj @ se3.inverse(a.T_cam_obj))


def off_deg(a: View, b: View) -> float:
    return float(np.degrees(se3.rotation_angle(a.T_cam_obj[:3, :3], b.T_cam_obj[:3, :3])))

"""The estimator: a printed box is found where it is; answers do not depend on order, threads or
repetition."""

from __future__ import annotations

from dataclasses import replace
from threading import Thread

import numpy as np
import pytest

from huepose.believe.state import State
from huepose.estimation import Estimator, EstimatorConfig, ObjectQuery, PoseEstimate, PosePrior
from huepose.geometry import Box, RgbdFrame, se3
from huepose.model.types import ReferenceModel
from huepose.rendering.render import render_depth
from huepose.support.errors import InputError
from tests.boxes import box_of
from tests.conftest import TakePicture
from tests.meshes import demo_objects


@pytest.fixture(scope="module")
def estimator(tea_box: ReferenceModel) -> Estimator:
    return Estimator({"tea_box": tea_box})


def same(a: PoseEstimate, b: PoseEstimate) -> bool:
    assert a.T_cam_obj is not None
    assert b.T_cam_obj is not None
    return np.array_equal(a.T_cam_obj, b.T_cam_obj) and (a.score, a.quality) == (b.score, b.quality)


def test_another_instance_is_found_beside_known_ones(
    estimator: Estimator, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    beside = standing.copy()
    beside[0, 3] += 0.1
    frame = take_picture([(tea_box.mesh, standing), (tea_box.mesh, beside)])
    around = Box.around(*(box_of(frame, tea_box, T) for T in (standing, beside)))
    for known, other in ((standing, beside), (beside, standing)):
        (answer,) = estimator.estimate(frame, [ObjectQuery("tea_box", around, others=(known,))])
        assert answer.T_cam_obj is not None
        assert np.linalg.norm(answer.T_cam_obj[:3, 3] - other[:3, 3]) < 0.002


def test_a_box_on_a_table_is_found_to_the_millimetre(
    estimator: Estimator, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    frame = take_picture([(tea_box.mesh, standing)], light=(0.8, 0.7, 0.5))
    box = box_of(frame, tea_box, standing)
    loose = Box(box.x - 6, box.y + 8, box.w * 1.05, box.h * 0.95)
    (answer,) = estimator.estimate(frame, [ObjectQuery("tea_box", loose, instance=7)])
    assert answer.found
    assert answer.state is State.TRACKING
    assert answer.instance == 7
    assert answer.T_cam_obj is not None
    assert answer.mask is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.001
    assert se3.rotation_angle(answer.T_cam_obj, standing) < np.radians(0.5)
    assert answer.state == "TRACKING"
    assert answer.quality > 0.95
    assert answer.margin > 0.2
    truth = render_depth(tea_box.mesh, standing, frame.camera) > 0
    assert (answer.mask & truth).sum() / (answer.mask | truth).sum() > 0.95
    assert answer.box is not None
    assert answer.box.iou(box) > 0.95
    assert sum(p for _, p in answer.alternatives) <= 1 - answer.quality


def test_the_covariance_is_symmetric_positive_and_small(
    estimator: Estimator, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    (answer,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", box_of(box_frame, tea_box, standing))])
    assert answer.covariance is not None
    sigma = np.sqrt(np.diag(answer.covariance))
    assert np.array_equal(answer.covariance, answer.covariance.T) or np.allclose(
        answer.covariance, answer.covariance.T
    )
    assert (np.linalg.eigvalsh(answer.covariance) > 0).all()
    assert (sigma[:3] < 0.005).all()
    assert (sigma[3:] < np.radians(4)).all()


def test_given_masks_are_used(
    estimator: Estimator, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    truth = render_depth(tea_box.mesh, standing, box_frame.camera) > 0
    (answer,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", masks=(truth,))])
    assert answer.T_cam_obj is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.001


def test_another_texture_is_doubted(
    estimator: Estimator, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    """The same shape with other colours: found with a lower score and a lower quality."""
    right = take_picture([(tea_box.mesh, standing)])
    wrong = take_picture([(demo_objects(1)["tea_box"], standing)])
    query = ObjectQuery("tea_box", box_of(right, tea_box, standing))
    (good,), (bad,) = estimator.estimate(right, [query]), estimator.estimate(wrong, [query])
    assert bad.score < good.score - 0.3
    assert bad.quality < good.quality - 0.05


def test_results_repeat_in_any_order_and_with_threads(
    estimator: Estimator, tea_box: ReferenceModel, take_picture: TakePicture, standing: np.ndarray
) -> None:
    beside = se3.compose(se3.make(np.eye(3), np.array([0.16, 0.0, 0.0])), standing)
    frame = take_picture([(tea_box.mesh, standing), (tea_box.mesh, beside)])
    queries = [
        ObjectQuery("tea_box", box_of(frame, tea_box, T), instance=k)
        for k, T in enumerate((standing, beside))
    ]
    first = estimator.estimate(frame, queries)
    again = estimator.estimate(frame, queries)
    reversed_ = estimator.estimate(frame, queries[::-1])[::-1]
    threaded = Estimator({"tea_box": tea_box}, EstimatorConfig(threads=2)).estimate(frame, queries)
    for answers in (again, reversed_, threaded):
        assert [a.instance for a in answers] == [0, 1]
        assert all(same(a, b) for a, b in zip(first, answers, strict=True))


def test_no_thread_is_started_while_it_works(
    tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A new thread without memory for its stack dies before it reports that it runs, and would be waited
    for."""
    threaded = Estimator({"tea_box": tea_box}, EstimatorConfig(threads=2))
    monkeypatch.setattr(Thread, "start", lambda _: pytest.fail("a thread is started"))
    query = ObjectQuery("tea_box", box_of(box_frame, tea_box, standing))
    assert [answer.found for answer in threaded.estimate(box_frame, [query, query])] == [True, False]


def test_a_prior_is_refined_and_scored_on_the_same_pixels(
    estimator: Estimator, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    box = box_of(box_frame, tea_box, standing)
    near = PosePrior(se3.perturb(standing, np.array([0.008, -0.006, 0.01, 0.08, -0.06, 0.05])))
    upside_down = PosePrior(se3.compose(standing, se3.make(np.diag([1.0, -1.0, -1.0]), np.zeros(3))))
    (good,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", box, prior=near)])
    (bad,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", box, prior=upside_down)])
    assert good.prior_score is not None
    assert bad.prior_score is not None
    assert good.prior_T_cam_obj is not None
    assert np.linalg.norm(good.prior_T_cam_obj[:3, 3] - standing[:3, 3]) < 0.003
    assert good.prior_score > good.score - 0.05
    assert bad.prior_score < bad.score - 0.3
    assert bad.T_cam_obj is not None
    assert se3.rotation_angle(bad.T_cam_obj, standing) < np.radians(1.0)


def test_a_prior_alone_says_where_to_look(
    estimator: Estimator, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    prior = PosePrior(se3.perturb(standing, np.array([0.01, 0.0, 0.0, 0.0, 0.1, 0.0])))
    (answer,) = estimator.estimate(box_frame, [ObjectQuery("tea_box", prior=prior)])
    assert answer.T_cam_obj is not None
    assert np.linalg.norm(answer.T_cam_obj[:3, 3] - standing[:3, 3]) < 0.001


def test_an_object_that_cannot_be_seen_is_not_found(
    estimator: Estimator, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    blind = replace(box_frame, depth=np.zeros_like(box_frame.depth))
    box = box_of(box_frame, tea_box, standing)
    behind = PosePrior(se3.make(np.eye(3), np.array([0.0, 0.0, -1.0])))
    millimetres = replace(box_frame, depth=box_frame.depth * np.float32(1000.0))
    half = box_frame.without(np.indices(box_frame.depth.shape)[0] < 200)
    no_depth = "There is no depth in the box, so there is nothing to look at."
    outside = "The box is outside of the image (640 x 480 pixels), so there is nothing to look at."
    for frame, query, why in (
        (blind, ObjectQuery("tea_box", box), "The frame has no depth (under 1 % of its pixels"),
        (blind, ObjectQuery("tea_box", box, prior=PosePrior(standing)), "The frame has no depth"),
        (millimetres, ObjectQuery("tea_box", box), "All depth is "),
        (half, ObjectQuery("tea_box", Box(20, 20, 30, 30)), no_depth),
        (box_frame, ObjectQuery("tea_box", Box(-50, -50, 20, 20)), outside),
        (box_frame, ObjectQuery("tea_box", prior=behind), "The prior is outside of the image, so"),
        (box_frame, ObjectQuery("tea_box", masks=(np.zeros((480, 640), bool),)), "The masks are empty, so"),
        (box_frame, ObjectQuery("tea_box", Box(30, 30, 0, 20)), "The box is empty (0 x 20 pixels), so"),
    ):
        (answer,) = estimator.estimate(frame, [query])
        assert not answer.found
        assert (answer.T_cam_obj, answer.covariance, answer.mask) == (None, None, None)
        assert (answer.state, answer.quality) == ("LOST", 0.0)
        assert answer.reason.startswith(why)


def test_arguments_of_another_type_are_refused(
    estimator: Estimator, tea_box: ReferenceModel, box_frame: RgbdFrame, standing: np.ndarray
) -> None:
    query = ObjectQuery("tea_box", box_of(box_frame, tea_box, standing))
    with pytest.raises(InputError, match=r"found str; expected reference models.*load_models\(dir\)"):
        Estimator("bundles")
    with pytest.raises(InputError, match=r"found tuple; expected a Box\. Make one: Box\(x, y, w, h\)"):
        ObjectQuery("tea_box", (1, 2, 3, 4))
    with pytest.raises(InputError, match=r"box of 'tea_box': found Box\(x=nan.*; expected finite numbers"):
        ObjectQuery("tea_box", Box(float("nan"), 2, 3, 4))
    with pytest.raises(
        InputError, match=r"prior of 'tea_box': found ndarray; expected a PosePrior.*Make one"
    ):
        ObjectQuery("tea_box", prior=np.eye(4))
    small = ObjectQuery("tea_box", masks=(np.ones((240, 320), bool),), others=(standing,))
    with pytest.raises(InputError, match=r"mask of 'tea_box': found \(240, 320\); expected \(480, 640\)"):
        estimator.estimate(box_frame, [small])
    with pytest.raises(InputError, match=r"queries: found ObjectQuery; expected a list of ObjectQuery"):
        estimator.estimate(box_frame, query)
    with pytest.raises(InputError, match=r"query: found str; expected an ObjectQuery"):
        estimator.estimate(box_frame, ["tea_box"])
    with pytest.raises(InputError, match=r"frame: found None; expected an RgbdFrame"):
        estimator.estimate(None, [query])


def test_wrong_queries_say_what_to_do(estimator: Estimator, box_frame: RgbdFrame) -> None:
    with pytest.raises(InputError, match="one of tea_box"):
        estimator.estimate(box_frame, [ObjectQuery("teabox", Box(0, 0, 9, 9))])
    with pytest.raises(InputError, match="neither box, masks nor prior"):
        estimator.estimate(box_frame, [ObjectQuery("tea_box")])
    with pytest.raises(InputError, match="size of the frame"):
        estimator.estimate(box_frame, [ObjectQuery("tea_box", masks=(np.ones((4, 4), bool),))])
    with pytest.raises(InputError, match="colorpair"):
        EstimatorConfig(method="best")


def test_warm_up_prepares_everything(tea_box: ReferenceModel) -> None:
    estimator = Estimator({"tea_box": tea_box})
    estimator.warm_up()
    assert Estimator({}).estimate is not None
    Estimator({}).warm_up()

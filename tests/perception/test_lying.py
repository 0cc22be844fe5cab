"""A card 5 mm thick on a table, which depth hardly shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from huepose.estimation import Estimator, ObjectQuery
from huepose.geometry import RgbdFrame, se3
from huepose.model import ReferenceModel
from huepose.perception.clear_view import clear_view, thin
from huepose.perception.view_detector import ViewDetector
from tests import onboarded
from tests.conftest import TakePicture, table_top

THICK = 0.005


@pytest.fixture(scope="module")
def card(tea_box: ReferenceModel) -> ReferenceModel:
    """The tea box, pressed flat."""
    scale = np.array([1.0, THICK / np.ptp(tea_box.mesh.vertices[:, 1]), 1.0], np.float32)
    mesh = replace(tea_box.mesh, vertices=tea_box.mesh.vertices * scale, digest=None)
    return onboarded.onboarded(mesh, "card")


@pytest.fixture(scope="module")
def lying() -> np.ndarray:
    """T_cam_obj of the card on its back."""
    on_its_back = se3.rotation_exp(np.array([-np.pi / 2.0, 0.0, 0.0]))
    turned = se3.rotation_exp(np.array([0.0, 0.0, 0.4])) @ on_its_back
    return se3.compose(table_top()[1], se3.make(turned, np.array([0.02, 0.05, THICK / 2.0])))


def noisy(frame: RgbdFrame) -> RgbdFrame:
    """The frame with the noise of a stereo camera's depth."""
    noise = np.random.default_rng(1).normal(0.0, 0.0015, frame.depth.shape)
    return replace(frame, depth=np.where(frame.depth > 0, frame.depth + noise, 0.0).astype(np.float32))


def test_the_least_thickness_is_that_between_the_faces(card: ReferenceModel, tea_box: ReferenceModel) -> None:
    assert card.thickness_m == pytest.approx(THICK, rel=0.02)
    assert tea_box.thickness_m == pytest.approx(0.06, rel=0.02)
    assert thin(card)
    assert not thin(tea_box)


def test_a_card_on_a_table_is_found_though_it_is_removed_with_the_table(
    card: ReferenceModel, take_picture: TakePicture, lying: np.ndarray
) -> None:
    frame = noisy(take_picture([(card.mesh, lying)]))
    assert clear_view(frame, card.diameter_m) is None, "nothing stands on the table"
    best = ViewDetector({"card": card}).detect(frame, ["card"])[0]
    (answer,) = Estimator({"card": card}).estimate(frame, [ObjectQuery("card", best.box, searched=True)])
    assert answer.state == "TRACKING"
    apart = se3.difference(lying, answer.T_cam_obj)
    assert np.linalg.norm(apart[:3]) < 0.004
    assert np.linalg.norm(apart[3:]) < np.radians(3.0)


def test_no_card_is_found_on_a_bare_table_or_where_it_is_known_to_be(
    card: ReferenceModel, take_picture: TakePicture, lying: np.ndarray
) -> None:
    detector = ViewDetector({"card": card})
    assert detector.detect(noisy(take_picture([])), ["card"]) == []
    frame = noisy(take_picture([(card.mesh, lying)]))
    assert detector.detect(frame, ["card"], followed={"card": [lying]}) == []


def test_a_card_is_searched_for_on_planes_only_in_a_thorough_search(
    card: ReferenceModel, take_picture: TakePicture, lying: np.ndarray
) -> None:
    frame = noisy(take_picture([(card.mesh, lying)]))
    assert ViewDetector({"card": card}).detect(frame, ["card"], thorough=[]) == []

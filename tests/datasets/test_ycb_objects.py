"""The 21 objects of YCB-Video and the offsets between their model frames."""

from __future__ import annotations

import numpy as np

from huepose.datasets.ycb_objects import T_posecnn_obj, is_ycbv, ycb_named, ycb_objects
from huepose.geometry import se3


def test_all_objects_have_names_and_offsets() -> None:
    assert list(ycb_objects()) == list(range(1, 22))
    assert ycb_objects()[16].name == "036_wood_block"
    assert ycb_named("052_extra_large_clamp").object_id == 20
    assert ycb_named("tea_box") is None
    np.testing.assert_allclose(ycb_objects()[5].frame_offset_m, [0.00126, 0.002452, -0.011884])
    # Both origins lie in the object, so no offset is longer than half an object.
    assert all(np.linalg.norm(o.frame_offset_m) < 0.05 for o in ycb_objects().values())


def test_nvdu_frames_are_rigid_and_exist_for_the_objects_of_fast_ycb() -> None:
    known = {o.name: o.T_nvdu_posecnn for o in ycb_objects().values() if o.T_nvdu_posecnn is not None}
    fast = ("003_cracker_box", "004_sugar_box", "005_tomato_soup_can", "006_mustard_bottle")
    assert {*fast, "009_gelatin_box", "010_potted_meat_can"} <= known.keys()
    assert all(se3.is_rigid(T, 1e-9) for T in known.values())


def test_a_point_goes_from_bop_to_posecnn_and_back() -> None:
    offset = ycb_objects()[2].frame_offset_m
    np.testing.assert_allclose(se3.apply(T_posecnn_obj(offset), offset[None]), np.zeros((1, 3)), atol=1e-12)


def test_ycbv_is_recognised_by_its_diameters() -> None:
    theirs = {i: 1000 * o.diameter_m for i, o in ycb_objects().items() if o.diameter_m}
    assert is_ycbv({i: 1.004 * d for i, d in theirs.items()} | {16: 1.0})
    assert not is_ycbv({**theirs, 3: 1.02 * theirs[3]})
    assert not is_ycbv({1: 102.1, 5: 201.4, 6: 154.5})  # LINEMOD's
    assert not is_ycbv({})

"""Pairs for verification are what they are said to be, and other cameras change what they should."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from huepose.propose.view_pictures import NEAR
from huepose.training.object_buffer import ObjectBuffer
from huepose.training.sensing import mixed, reprinted, shone_on
from huepose.training.verification import (
    CANDIDATES,
    ROUGH_DEG,
    WRONG,
    Shown,
    _onto_surface,
    _repainted,
    pairs,
    rough_views,
)
from huepose.training.view_codes import _angles
from huepose.training.windows import endless

pytestmark = pytest.mark.filterwarnings("ignore")


@pytest.fixture(scope="module")
def buffer() -> ObjectBuffer:
    made, drawn = ObjectBuffer(2, "cpu"), endless(5, 1)
    made.add(next(drawn))
    made.add(next(drawn))
    return made


def shown(buffer: ObjectBuffer) -> Shown:
    """Two windows on objects 0 and 1, one beside object 0; four views of each object."""
    return Shown(
        whose=torch.tensor([0, 1, 0]),
        which=torch.tensor([0, 3, 2]),
        on=2,
        shift=torch.tensor([[0.0, 0.0], [0.0, 0.0], [0.4, 0.0]]),
        nearest=torch.tensor([0, 12]),
        rough=torch.tensor([[24] * CANDIDATES, [36] * CANDIDATES]),
        view_objects=torch.arange(2).repeat_interleave(4),
        view_numbers=torch.tensor([0, 100, 200, 300] * 2),
    )


def test_true_pairs_show_their_object_and_no_wrong_pair_shows_the_windows_own(buffer):
    torch.manual_seed(0)
    asked = shown(buffer)
    # The window's own object is the likest, and must not be taken for a wrong one.
    similar = torch.where(asked.view_objects[None] == asked.whose[:, None], 0.9, 0.1)
    pictures, there, cells = pairs(buffer, asked, similar, rough=True)
    assert there[:6].tolist() == [1.0] * 6
    assert not there[6:].any()
    assert len(there) in range(6 + 3 * WRONG, 6 + 3 * WRONG + 3)
    assert pictures.shape == (len(there), 12, 64, 64)
    assert (cells[:6].flatten(1).amax(1) > 0.3).all()
    assert not cells[6:].any()
    of_refined = pairs(buffer, asked, similar, rough=False)[1]
    assert of_refined.tolist()[:10] == [1.0] * 4 + [0.0] * 6
    known = pictures[:, 10] > 0
    views = [buffer.views_of(asked.view_objects[k : k + 1], asked.view_numbers[k : k + 1]) for k in range(8)]
    outlines = [torch.isfinite(relief[0]) for _, relief in views]
    for row, own in zip(range(6, 10), (0, 0, 1, 1), strict=True):
        others = outlines[4:] if own == 0 else outlines[:4]
        assert any(torch.equal(known[row], outline) for outline in others)


def test_a_rough_pose_is_that_view_of_its_kind_whose_relief_fits_and_is_turned_by_tens_of_degrees(buffer):
    torch.manual_seed(0)
    rotations = Rotation.random(50, rng=np.random.default_rng(0)).as_matrix()
    apart = _angles(torch.as_tensor(rotations))
    turned = apart.gather(1, rough_views(apart))
    assert turned.min() > ROUGH_DEG[0]
    assert 20.0 < turned.median() < 45.0
    asked = shown(buffer)
    numbers = torch.arange(CANDIDATES) * 80
    asked = replace(asked, rough=torch.stack([numbers, numbers]))
    pictures, _, _ = pairs(buffer, asked, torch.zeros(3, 8), rough=True)
    for k in (0, 1):
        relief = buffer.windows_of(*(x[k : k + 1] for x in (asked.whose, asked.which)), *STILL)[1][0]
        views = [buffer.views_of(asked.whose[k : k + 1], numbers[j : j + 1])[1][0] for j in range(CANDIDATES)]
        misfits = [_misfit(relief, view) for view in views]
        best = views[int(np.argmin(misfits))]
        assert torch.equal(pictures[4 + k, 10] > 0, torch.isfinite(best))


STILL = torch.zeros(1, 2), torch.ones(1), torch.zeros(1)


def _misfit(seen, drawn):
    """Mean distance in depth where the view shows its object, after both are brought together."""
    apart = (seen - drawn - _onto_surface(seen[None], drawn[None])[0]).abs().clamp(max=NEAR)
    return float(torch.nan_to_num(apart, nan=NEAR)[torch.isfinite(drawn)].mean())


def test_a_wrong_pose_is_brought_onto_the_surface_that_is_seen_as_refinement_would():
    drawn = torch.full((2, 64, 64), torch.nan)
    drawn[:, 20:40, 20:40] = 0.1
    seen = torch.full((2, 64, 64), 2.0)
    seen[0, :, :30] = 0.25
    assert _onto_surface(seen, drawn).tolist() == pytest.approx([0.15, 0.0])


def test_most_repainted_pictures_only_have_their_channels_exchanged():
    torch.manual_seed(0)
    red = torch.zeros(400, 3, 64, 64)
    red[:, 0] = 0.8
    relief = torch.full((400, 64, 64), torch.nan)
    relief[:, 10:50, 10:50] = 0.0
    painted, differs = _repainted(red, relief)
    assert torch.equal(painted[:, :, :10], red[:, :, :10])
    middle = painted[:, :, 30, 30]
    plainly = (middle[:, 0] < 0.06) & ((middle[:, 1:] > 0.74).sum(1) == 1)
    # One order of six leaves red where it is.
    assert 0.45 < plainly.float().mean() < 0.65
    assert differs[plainly].all()
    assert 0.05 < (~differs).float().mean() < 0.2


def test_other_filters_leave_grey_grey_and_sheen_and_prints_only_come_where_they_are_asked_for():
    torch.manual_seed(0)
    grey = torch.full((4, 3, 64, 64), 0.4)
    assert torch.allclose(mixed(grey), grey, atol=1e-6)
    colored = grey * torch.tensor([1.0, 0.5, 0.1])[:, None, None]
    assert not torch.allclose(mixed(colored), colored, atol=0.01)
    for change in (shone_on, reprinted):
        assert torch.equal(change(colored, 0.0), colored)
        assert not torch.equal(change(colored, 1.0), colored)
    assert (shone_on(colored, 1.0) >= colored).all()
    assert np.isfinite(reprinted(colored, 1.0).numpy()).all()

"""Training pairs for verification are labelled correctly; simulated cameras change only what they should."""

import numpy as np
import pytest
import torch

from huepose.training.object_buffer import ObjectBuffer
from huepose.training.sensing import mixed, reprinted, shone_on
from huepose.training.verification import WRONG, Shown, _onto_surface, pairs
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
        view_objects=torch.arange(2).repeat_interleave(4),
        view_numbers=torch.tensor([0, 100, 200, 300] * 2),
    )


def test_true_pairs_show_the_object_of_the_window_and_wrong_pairs_another(buffer):
    torch.manual_seed(0)
    asked = shown(buffer)
    # The window's own object is the most similar; it must not be used as a wrong one.
    similar = torch.where(asked.view_objects[None] == asked.whose[:, None], 0.9, 0.1)
    pictures, there, cells = pairs(buffer, asked, similar)
    assert there[:4].tolist() == [1.0] * 4
    assert not there[4:].any()
    assert len(there) in range(4 + 3 * WRONG, 4 + 3 * WRONG + 3)
    assert pictures.shape == (len(there), 12, 64, 64)
    assert (cells[:4].flatten(1).amax(1) > 0.3).all()
    assert not cells[4:].any()
    known = pictures[:, 10] > 0
    views = [buffer.views_of(asked.view_objects[k : k + 1], asked.view_numbers[k : k + 1]) for k in range(8)]
    outlines = [torch.isfinite(relief[0]) for _, relief in views]
    for row, own in zip(range(4, 8), (0, 0, 1, 1), strict=True):
        others = outlines[4:] if own == 0 else outlines[:4]
        assert any(torch.equal(known[row], outline) for outline in others)


def test_a_wrong_pose_is_moved_onto_the_measured_surface():
    drawn = torch.full((2, 64, 64), torch.nan)
    drawn[:, 20:40, 20:40] = 0.1
    seen = torch.full((2, 64, 64), 2.0)
    seen[0, :, :30] = 0.25
    assert _onto_surface(seen, drawn).tolist() == pytest.approx([0.15, 0.0])


def test_other_colour_filters_keep_grey_and_sheen_and_reprints_have_a_share():
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

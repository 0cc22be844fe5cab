"""The packaged network as a start: it computes what the packaged file does, and only its end is trained."""

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="the extra `train` is not installed")
pytest.importorskip("onnx", reason="the extra `train` is not installed")

from huepose.propose import view_pictures  # noqa: E402
from huepose.propose.view_codes import codes_of_windows  # noqa: E402
from huepose.training.fine_tuning import KEPT_MODULES, packaged_network  # noqa: E402
from huepose.training.view_code_network import window_codes  # noqa: E402
from huepose.training.windows import endless  # noqa: E402


def test_it_computes_the_codes_of_the_packaged_file():
    drawn = next(endless(5, 1))
    middle = np.s_[:, 32:96, 32:96]
    colors, reliefs = drawn.colors[middle], drawn.reliefs[middle].astype(np.float32)
    pictures = torch.from_numpy(view_pictures.network_input(colors, reliefs, clean=False))
    net = packaged_network(pictures)
    with torch.no_grad():
        codes = window_codes(net.eval()(pictures)).numpy()
    assert ((codes * codes_of_windows(colors, reliefs)).sum(1) > 0.99).all()
    # In training the statistics are those of the batch: of these pictures the same ones.
    with torch.no_grad():
        of_batch = window_codes(net.train()(pictures)).numpy()
    assert ((codes * of_batch).sum(1) > 0.999).all()


def test_only_the_end_of_the_network_is_trained():
    net = packaged_network(torch.zeros(2, 6, 64, 64))
    kept = sum(p.numel() for p in net.body[:KEPT_MODULES].parameters())
    trained = sum(p.numel() for p in net.parameters() if p.requires_grad)
    assert trained == sum(p.numel() for p in net.parameters()) - kept
    assert net.body[KEPT_MODULES].out_channels == 128

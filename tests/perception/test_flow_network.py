"""Flow by a network that answers with the motion of a blue spot: a known translation, at two sizes."""

from __future__ import annotations

import numpy as np
import pytest

from huepose.geometry import Box
from huepose.perception.flow_network import NetworkFlow
from huepose.perception.sessions import open_network
from huepose.support.errors import InputError
from tests.perception import networks


def two_images(du, dv):
    """Two images: a blue spot moves by (du, dv) px to the right and down, a red one stays."""
    out = []
    for u, v in ((100, 70), (100 + du, 70 + dv)):
        image = np.zeros((160, 200, 3), np.uint8)
        image[v - 4 : v + 5, u - 4 : u + 5, 2] = 255
        image[40:60, 60:80, 0] = 200
        out.append(image)
    return out


@pytest.fixture(scope="module", params=[(96, 128), (256, 208)])
def flow(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("flow") / "flow.onnx"
    return NetworkFlow(open_network(networks.blue_follower(path, *request.param)))


@pytest.mark.parametrize(("du", "dv"), [(0, 0), (8, -5), (-12, 16)])
@pytest.mark.parametrize("box", [Box(0, 0, 200, 160), Box(60, 30, 90, 90)])
def test_a_pure_translation_is_the_same_at_every_size_of_the_input(flow, box, du, dv):
    found = flow(*two_images(du, dv), box)
    moved, good = found.at(np.array([[100.0, 70.0], [90.5, 80.25]]))
    assert moved == pytest.approx(np.array([[du, dv]] * 2), abs=0.15)
    assert good.all()
    assert found.backward[10, 10] == pytest.approx([-du, -dv], abs=0.15)


def test_the_window_covers_the_box_and_takes_the_shape_of_the_input(flow):
    found = flow(*two_images(3, 3), Box(80, 50, 40, 40))
    height, width = found.consistent.shape
    assert found.x0 <= 80 <= 120 <= found.x0 + width
    assert found.y0 <= 50 <= 90 <= found.y0 + height
    assert width / height == pytest.approx(flow._size[1] / flow._size[0], rel=0.05)
    assert flow(*two_images(3, 3), Box(300, 300, 10, 10)) is None or width <= 200


def test_other_networks_are_refused(tmp_path):
    one = open_network(networks.identity(tmp_path / "one.onnx", (1, 3, 64, 64)))
    with pytest.raises(InputError, match="two inputs of float 1 x 3 x H x W"):
        NetworkFlow(one)
    odd = open_network(networks.blue_follower(tmp_path / "odd.onnx", 40, 64))
    with pytest.raises(InputError, match="multiples of 16"):
        NetworkFlow(odd)


def test_nan_flow_is_no_flow(tmp_path):
    class Broken:
        """A network whose answer is NaN once it has been opened."""

        def __init__(self, network):
            self._network, self._answers = network, 0

        def __getattr__(self, name):
            return getattr(self._network, name)

        def run(self, inputs):
            self._answers += 1
            found = self._network.run(inputs)
            return found if self._answers == 1 else {k: np.full_like(v, np.nan) for k, v in found.items()}

    flow = NetworkFlow(Broken(open_network(networks.blue_follower(tmp_path / "flow.onnx", 96, 128))))
    assert flow(*two_images(3, 3), Box(0, 0, 200, 160)) is None

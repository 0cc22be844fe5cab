import json
from dataclasses import replace

import numpy as np
import onnx
import pytest
import torch

from huepose.paper.rotation_network import WEIGHTS, OnnxRotation
from huepose.support.errors import InputError
from huepose.training.network import AttentionDgcnn, EdgeConvolution, geodesic, neighbours, rotation_of_six
from huepose.training.rotation import RotationTraining, export, train
from huepose.training.runs import Course, Settings, Training, check_device, checkpoint, save_checkpoint
from huepose.training.view_codes import ViewCodeTraining
from huepose.training.view_codes import train as train_views

pytestmark = pytest.mark.filterwarnings("ignore")


def test_an_edge_convolution_is_the_largest_linear_output_over_the_edges():
    torch.manual_seed(0)
    layer = EdgeConvolution(3, 5).eval()
    x = torch.randn(2, 20, 3)
    near = neighbours(x, 4)
    slow = torch.zeros(2, 20, 5)
    for b in range(2):
        for i in range(20):
            slow[b, i] = layer.other(x[b, near[b, i]] - x[b, i]).amax(0) + layer.own(x[b, i])
    slow = torch.nn.functional.leaky_relu(layer.normal(slow.transpose(1, 2)).transpose(1, 2), 0.2)
    assert torch.allclose(layer(x, near), slow, atol=1e-5)


def test_neighbours_are_the_nearest_points_beginning_with_the_point_itself():
    x = torch.tensor([[[0.0], [1.0], [3.0], [7.0]]])
    assert neighbours(x, 2)[0].tolist() == [[0, 1], [1, 0], [2, 1], [3, 2]]


def test_six_numbers_give_a_rotation_and_zeros_the_identity():
    assert torch.allclose(rotation_of_six(torch.zeros(1, 6))[0], torch.eye(3), atol=1e-6)
    R = rotation_of_six(torch.randn(50, 6))
    assert torch.allclose(R @ R.transpose(1, 2), torch.eye(3).expand(50, 3, 3), atol=1e-5)
    assert torch.allclose(torch.linalg.det(R), torch.ones(50), atol=1e-5)


@pytest.mark.parametrize("kind", ["residual", "direct"])
def test_the_trained_network_has_the_shape_of_the_shipped_one(kind: str) -> None:
    shipped = onnx.load(str(WEIGHTS / f"{kind}.onnx"))
    known = {one.name: tuple(one.dims) for one in shipped.graph.initializer}
    norms = {
        name: tuple(one.shape) for name, one in AttentionDgcnn().state_dict().items() if ".normal." in name
    }
    shared = norms.keys() & known.keys()
    assert len(shared) >= 12
    assert {name: norms[name] for name in shared} == {name: known[name] for name in shared}


def test_the_geodesic_distance_is_the_angle_between_rotations():
    turn = torch.tensor([[[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]])
    assert geodesic(turn, torch.eye(3)[None]).item() == pytest.approx(np.pi / 2, abs=1e-5)
    assert geodesic(turn, turn).item() < 1e-5


def test_the_exported_network_gives_the_output_of_the_trained_one(tmp_path):
    torch.manual_seed(1)
    net = AttentionDgcnn().eval()
    export(net, tmp_path / "rotation.onnx")
    assert b".py" not in (tmp_path / "rotation.onnx").read_bytes()  # no paths of source files
    rng = np.random.default_rng(0)
    features, weights = rng.normal(size=(128, 15)).astype(np.float32), np.linspace(1.0, 0.5, 128)
    R = OnnxRotation(tmp_path / "rotation.onnx")(features, weights)
    with torch.no_grad():
        expected = net(torch.from_numpy(features)[None], torch.from_numpy(weights.astype(np.float32))[None])
    assert pytest.approx(expected[0].numpy(), abs=1e-4) == R


def test_training_writes_networks_and_resumes(tmp_path):
    kinds = ("residual", "direct")
    short = RotationTraining(kinds=kinds, steps=3, batch=8, every=2, validation=16, workers=0, room=64)
    first = train(short, tmp_path)
    made = {f"{kind}.{end}" for kind in kinds for end in ("onnx", "json", "png")}
    assert {p.name for p in tmp_path.iterdir()} == made | {"checkpoint.pt"}
    for kind in kinds:
        assert json.loads((tmp_path / f"{kind}.json").read_text())["steps"] == first[kind]["steps"] == 3
    again = train(replace(short, steps=5, workers=1), tmp_path, True)
    assert again["direct"]["steps"] == 5
    with pytest.raises(InputError, match=r"kind residual\+direct"):
        train(RotationTraining(kinds=("direct",)), tmp_path, True)
    kept = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    with pytest.raises(InputError, match=r"found one of an earlier training; .* with --resume"):
        train(short, tmp_path)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == kept


def test_a_training_that_ends_before_its_first_step_writes_nothing(tmp_path):
    net = torch.nn.Linear(1, 1)

    def interrupted():
        raise KeyboardInterrupt
        yield

    for batches, hours in ((interrupted(), 1.0), (iter([1]), 1e-12)):
        settings = Settings(hours=hours)
        training = Training.begun(
            tmp_path, "line", settings, torch.optim.SGD(net.parameters()), {"line": net}, None
        )
        with pytest.raises(InputError, match="its end before its first step"):
            training.run(batches, lambda batch: None, lambda course: None)
        assert list(tmp_path.iterdir()) == []


class TestCheckpoint:
    """The file from which a training resumes."""

    def test_a_checkpoint_of_a_gpu_is_read_without_a_gpu(self, tmp_path, monkeypatch):
        monkeypatch.setattr(torch.serialization, "location_tag", lambda storage: "cuda:7")
        parts = begun(net := torch.nn.Linear(1, 1))
        save_checkpoint(tmp_path, "line", Course(steps=5), parts)
        monkeypatch.undo()
        saved = checkpoint(tmp_path, "line", resume=True)
        assert saved["line"]["weight"].device.type == "cpu"
        other = torch.nn.Linear(1, 1)
        settings = (Settings(), begun(other)["optimiser"], {"line": other})
        assert Training.begun(tmp_path, "line", *settings, saved).course.steps == 5
        assert torch.equal(other.weight, net.weight)

    @pytest.mark.parametrize("content", ["garbage", "", "cut", "a list"])
    def test_a_damaged_checkpoint_is_refused_with_what_to_do(self, tmp_path, content):
        file = tmp_path / "checkpoint.pt"
        save_checkpoint(tmp_path, "line", Course(), begun(torch.nn.Linear(1, 1)))
        if content == "a list":
            torch.save([1, 2], file)
        else:
            file.write_bytes(file.read_bytes()[:1000] if content == "cut" else content.encode())
        with pytest.raises(InputError, match=r"checkpoint\.pt: found a damaged file.*train without --resume"):
            checkpoint(tmp_path, "line", resume=True)

    def test_a_checkpoint_of_other_networks_is_refused_with_what_to_do(self, tmp_path):
        save_checkpoint(tmp_path, "line", Course(), begun(torch.nn.Linear(1, 1)))
        saved, wider = checkpoint(tmp_path, "line", resume=True), torch.nn.Linear(2, 1)
        settings = (Settings(), begun(wider)["optimiser"], {"line": wider})
        with pytest.raises(
            InputError, match=r"checkpoint\.pt: found networks of another shape; .*without --resume"
        ):
            Training.begun(tmp_path, "line", *settings, saved)


def begun(net):
    """The parts of a training of one layer."""
    return {"optimiser": torch.optim.AdamW(net.parameters()), "line": net}


@pytest.mark.parametrize("training", [train, train_views])
def test_a_training_that_cannot_begin_is_refused_before_rendering(training, tmp_path, monkeypatch):
    def rendered(*_):
        raise AssertionError

    for module in ("rotation", "view_codes"):
        monkeypatch.setattr(f"huepose.training.{module}.endless_loader", rendered)
    settings = RotationTraining if training is train else ViewCodeTraining
    out = tmp_path / "out"
    with pytest.raises(InputError, match=r"no such file\. Train without --resume first"):
        training(settings(), out, resume=True)
    with pytest.raises(
        InputError, match=r"device gpu: found none .*; expected cpu, or cuda if there is a GPU"
    ):
        training(settings(device="gpu"), out)
    assert not out.exists()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_a_missing_gpu_is_refused_as_device():
    with pytest.raises(InputError, match=r"device cuda: found none .*Leave --device out"):
        check_device("cuda")

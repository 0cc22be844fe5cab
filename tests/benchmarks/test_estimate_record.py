"""Results in pieces give the figures of one run; results of different options are not mixed."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from huepose.evaluation.estimate_rows import EstimateResult, EstimateRow
from huepose.evaluation.tables.journal import Journal
from huepose.evaluation.targets import PoseError
from huepose.support.errors import InputError

sys.path.insert(0, str(Path(__file__).resolve().parents[2] / "benchmarks"))

import estimate
from estimate import key_of, piece_of, summary


def _row(scene: str, image: int, add_m: float) -> EstimateRow:
    T = None if np.isinf(add_m) else np.eye(4)
    error = PoseError(add_m, add_m / 2, add_m, add_m < 0.01)
    return EstimateRow(scene, image, 0, 5, 0.8, T, error, 0.1, 0.5, "LOST", 0.1, 0, None)


def _keep(file: Path, image: tuple[str, int], rows: list[EstimateRow], cpu_s: list[float]) -> Journal:
    """Record the results of one image, as an interrupted run does."""
    journal = Journal(file, {"seed": 0})
    journal.add(key_of("fgr", "auto", image), piece_of(image, rows, cpu_s))
    return journal


def test_figures_of_pieces_equal_those_of_one_run(tmp_path: Path) -> None:
    rows = [_row("a", 1, 0.004), _row("a", 2, 0.03), _row("b", 1, np.inf), _row("b", 1, 0.002)]
    whole = EstimateResult(rows, [], 0, "perturbed", "auto", (0,)).summary()
    images = [("a", 1), ("a", 2), ("b", 1)]
    parts = (rows[:1], rows[1:2], rows[2:])
    for image, own, cpu_s in zip(images, parts, ([0.2], [0.4], [0.0, 0.6]), strict=True):
        _keep(tmp_path / "answers", image, own, cpu_s)
    journal = Journal(tmp_path / "answers", {"seed": 0})
    assert all(journal.done(key_of("fgr", "auto", image)) for image in images)
    assert not journal.done(key_of("fgr", "gt", ("a", 1)))
    found = summary(journal, "fgr", "auto", images)
    assert found is not None
    for name in ("recall_add", "recall_adds", "auc_add", "auc_adds", "interval95", "instances"):
        assert found[name] == whole[name]
    assert found["recall_add"] == 50.0
    assert found["cpu_s_p50"] == pytest.approx(0.4)  # 0.0 s, of an image without a pose, is not counted
    first = summary(journal, "fgr", "auto", images[:1])
    assert first is not None
    assert first["recall_add"] == 100.0
    assert summary(journal, "ppf", "auto", images) is None


def test_answers_of_other_options_are_not_mixed(tmp_path: Path) -> None:
    file = tmp_path / "answers"
    _keep(file, ("a", 1), [_row("a", 1, 0.004)], [0.2])
    with pytest.raises(InputError, match="Choose another place"):
        Journal(file, {"seed": 1})
    for other in ("[1, 2\n", '{"seed": 0}\n[3]\n'):
        file.write_text(other)
        with pytest.raises(InputError, match="not a journal"):
            Journal(file, {"seed": 0})


def test_results_of_other_reference_models_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["estimate.py", "--bop", "scene", "--bundles", "bundles", "--json", str(tmp_path / "answers")]
    monkeypatch.setattr(sys, "argv", words)
    monkeypatch.setattr(estimate, "BopScene", lambda path: SimpleNamespace(path=path, image_ids=()))

    def run(digest: str) -> None:
        model = SimpleNamespace(name="box", object_id=5, digest=digest)
        monkeypatch.setattr(estimate, "load_models", lambda _: {"box": model})
        estimate.main()

    run("one")
    run("one")
    with pytest.raises(InputError, match="models"):
        run("other")

"""`huepose doctor`: what it reports about this machine and a deployment."""

import json

import pytest

from huepose_services.cli.main import main
from huepose_services.doctor import checks
from huepose_services.doctor.checks import Finding
from huepose_services.runtime.session import MIB


def _findings(arguments, capsys):
    code = main(["doctor", "--json", *map(str, arguments)])
    return code, {row["subject"]: row for row in json.loads(capsys.readouterr().out)}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_NETWORKS", str(tmp_path / "networks"))
    return tmp_path / "networks"


def test_all_parts_of_this_machine_are_checked(capsys):
    code, found = _findings([], capsys)
    assert {"python", "packages", "providers", "locked memory", "shared memory", "clock", "governor"} <= set(
        found
    )
    assert {"realsense", "oak", "networks", "reference models"} <= set(found)
    assert "onnxruntime" in found["packages"]["found"]
    assert "cpu" in found["providers"]["found"]
    assert code == int(any(row["state"] == "bad" for row in found.values()))
    # Whatever is wrong or could be better has a fix.
    assert all(row["fix"] for row in found.values() if row["state"] in ("bad", "note"))


def test_without_a_deployment_the_output_ends_with_how_to_check_a_camera(tmp_path, capsys):
    pointer = "huepose doctor pipeline.yaml --camera"
    main(["doctor"])
    assert capsys.readouterr().out.rstrip().endswith(pointer)
    path = tmp_path / "pipeline.yaml"
    path.write_text("camera: {truth: true}\n")
    main(["doctor", str(path)])
    assert pointer not in capsys.readouterr().out


def test_missing_parts_of_a_deployment_are_bad(tmp_path, capsys):
    path = tmp_path / "pipeline.yaml"
    path.write_text(
        "camera: {source: realsense}\nbundles: nowhere\nobjects: [{name: mug}]\n"
        "detector: {kind: yolo, model: missing.onnx, classes: {mug: 0}}\nnetworks: {providers: [tensorrt]}\n"
    )
    code, found = _findings([path], capsys)
    assert code == 1
    bad = {name for name, row in found.items() if row["state"] == "bad"}
    assert {"realsense", "reference models", "networks", "providers"} <= bad
    assert "missing.onnx" in found["networks"]["found"]


def test_a_damaged_network_is_reported(folder, capsys):
    folder.mkdir()
    (folder / "yolox-nano.onnx").write_bytes(b"damaged")
    code, found = _findings([], capsys)
    assert code == 1
    assert "SHA-256" in found["networks"]["found"]


@pytest.mark.parametrize(
    ("limit", "state", "text"),
    [
        (None, "ok", "no limit"),
        (8 * MIB, "ok", "8192 KiB"),
        (6 * MIB, "note", "so they are sent over the socket"),
    ],
)
def test_locked_memory_is_compared_with_the_pool(monkeypatch, limit, state, text):
    monkeypatch.setattr(checks, "lock_limit", lambda: limit)
    finding = next(checks.memory(6.0))
    assert (finding.subject, finding.state) == ("locked memory", state)
    assert text in finding.found


def test_two_onnxruntimes_are_named(monkeypatch):
    versions = {"onnxruntime": "1.31.1", "onnxruntime-gpu": "1.31.1", "numba": "0.68"}
    monkeypatch.setattr(checks, "installed_version", versions.get)
    bad = [finding for finding in checks.versions() if finding.bad]
    assert len(bad) == 1
    assert "overwrite each other" in bad[0].fix


def test_a_line_says_what_to_do():
    assert Finding("clock", "ok", "tsc").line() == "OK   clock            tsc"
    assert Finding("oak", "bad", "none", "Plug it in.").line().endswith("-> Plug it in.")

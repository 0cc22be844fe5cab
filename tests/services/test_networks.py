"""Networks by name: the list, adding, fetching with a real server, and their place in pipeline.yaml."""

import hashlib
import json
import re
import sys
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import numpy as np
import onnx
import onnxruntime as ort
import pytest

from huepose.perception.flow_network import NetworkFlow
from huepose.perception.sessions import PROVIDERS, open_network
from huepose.support.errors import InputError
from huepose_services import catalogue
from huepose_services import networks as deployed
from huepose_services.catalogue import fetch
from huepose_services.cli.main import main
from tests.perception import networks
from tests.services.conftest import parse


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HUEPOSE_NETWORKS", str(tmp_path / "networks"))
    return tmp_path / "networks"


@pytest.fixture
def mine(tmp_path):
    return networks.constant_output(tmp_path / "Mine.v2.onnx", np.zeros((1, 30, 6)))


CONTENT = np.random.default_rng(0).bytes(300_000)


@pytest.fixture
def entry(folder):
    """A known network whose file is CONTENT."""
    known = catalogue.KnownNetwork(
        "known", "detector", "MIT", "somewhere", None, len(CONTENT), hashlib.sha256(CONTENT).hexdigest()
    )
    return catalogue.Entry(known, folder / "known.onnx")


class Server:
    """Serves CONTENT; `breaks_after` bytes once, with or without ranges."""

    def __init__(self):
        self.breaks_after, self.ranges, self.content, self.asked = None, True, CONTENT, []
        outer = self

        class Handler(BaseHTTPRequestHandler):
            def do_GET(self):
                outer.answer(self)

            def log_message(self, *arguments):
                pass

        self._server = HTTPServer(("127.0.0.1", 0), Handler)
        self.url = f"http://127.0.0.1:{self._server.server_port}/known.onnx"
        self._thread = threading.Thread(target=self._server.serve_forever, daemon=True)
        self._thread.start()

    def answer(self, request):
        start = 0
        if self.ranges and (asked := request.headers.get("Range")):
            start = int(asked.removeprefix("bytes=").rstrip("-"))
        self.asked.append(start)
        body = self.content[start:]
        request.send_response(206 if start else 200)
        request.send_header("Content-Length", str(len(body)))
        request.end_headers()
        limit, self.breaks_after = self.breaks_after, None
        request.wfile.write(body[:limit])

    def close(self):
        self._server.shutdown()
        self._server.server_close()


@pytest.fixture
def server():
    started = Server()
    yield started
    started.close()


def test_a_known_network_is_fetched_once_and_checked(server, entry):
    assert fetch(entry, server.url).read_bytes() == CONTENT
    fetch(entry, server.url)
    assert server.asked == [0]


@pytest.mark.parametrize("ranges", [True, False])
def test_a_download_that_broke_off_is_continued(server, entry, ranges):
    server.breaks_after, server.ranges = 100_000, ranges
    with pytest.raises(InputError, match="the downloaded part is kept"):
        fetch(entry, server.url)
    assert not entry.path.exists()
    assert fetch(entry, server.url).read_bytes() == CONTENT
    assert server.asked == [0, 100_000 if ranges else 0]


def test_a_file_with_another_digest_is_deleted(server, entry, folder):
    server.content = CONTENT[:-1] + b"x"
    with pytest.raises(InputError, match="expected " + entry.network.sha256):
        fetch(entry, server.url)
    assert list(folder.iterdir()) == []


def test_without_a_server_it_says_where_the_file_goes(entry):
    with pytest.raises(InputError, match=r"copy the file to .*known\.onnx"):
        fetch(entry, "http://127.0.0.1:9/known.onnx")


def test_a_network_without_a_digest_is_not_fetched(entry, server):
    unknown = replace(entry, network=replace(entry.network, sha256=None))
    with pytest.raises(InputError, match="huepose models add FILE --name known"):
        fetch(unknown, server.url)
    assert server.asked == []


def test_progress_is_shown_on_a_terminal(server, entry, monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    fetch(entry, server.url)
    said = capsys.readouterr().err
    assert re.search(r"\rknown: 0\.\d of 0\.3 MB, \d+ %", said)
    assert said.endswith("\x1b[Kknown: 0.3 MB downloaded\n")


def test_a_log_says_that_a_download_begins_and_ends(server, entry, capsys):
    fetch(entry, server.url)
    assert capsys.readouterr().err.splitlines() == ["known: downloading 0.3 MB", "known: 0.3 MB downloaded"]


def test_a_file_of_yours_is_added_listed_and_used_by_name(mine, folder, tmp_path, capsys, printed):
    assert main(["models", "add", str(mine)]) == 0
    assert (folder / "mine_v2.onnx").read_bytes() == mine.read_bytes()
    capsys.readouterr()
    listed = {row["name"]: row for row in json.loads(printed(["models", "list", "--json"]))}
    assert listed["mine_v2"]["here"]
    assert listed["mine_v2"]["sha256"] == hashlib.sha256(mine.read_bytes()).hexdigest()
    assert not listed["yolox-nano"]["here"]
    config = parse("detector: {kind: yolo, model: mine_v2, classes: {mug: 0}}", tmp_path / "p.yaml")
    deployed.check(config)
    # A file that changed after it was added is noticed at the start.
    (folder / "mine_v2.onnx").write_bytes(mine.read_bytes() + b"\0")
    with pytest.raises(InputError, match="SHA-256"):
        deployed.check(config)


def test_a_file_put_there_by_hand_is_listed(mine, folder, printed):
    folder.mkdir()
    (folder / "by-hand.onnx").write_bytes(mine.read_bytes())
    assert "by-hand  [installed]" in printed(["models"])


@pytest.mark.parametrize("name", ["yolox-nano", "../escape", "Capital"])
def test_a_wrong_file_or_name_is_not_added(mine, folder, name):
    with pytest.raises(InputError):
        catalogue.add(mine, name)
    assert not folder.exists()


def test_a_file_that_is_no_network_is_not_added(tmp_path):
    file = tmp_path / "text.onnx"
    file.write_text("hello")
    with pytest.raises(InputError, match="ONNX"):
        catalogue.add(file, "text")


def test_a_network_with_its_weights_in_another_file_is_not_added(mine, tmp_path, folder):
    split = tmp_path / "split.onnx"
    onnx.save(
        onnx.load(str(mine)), str(split), save_as_external_data=True, location="split.data", size_threshold=0
    )
    open_network(split)
    with pytest.raises(InputError, match=r"split.onnx: found .* weights are in another file.*external_data="):
        catalogue.add(split, "split")
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("words", [["add", "{mine}"], ["list"]])
def test_without_a_home_folder_the_error_names_the_variables_to_set(words, mine, monkeypatch, refused):
    """As in a container that runs as a user whom its system does not know."""

    def unknown(number):
        raise KeyError(number)

    for variable in ("HOME", "HUEPOSE_NETWORKS", "XDG_DATA_HOME"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setattr("pwd.getpwuid", unknown)
    said = refused(["models", *(word.format(mine=mine) for word in words)])
    assert "the user's home folder: found none: HOME is not set. Set HOME, or HUEPOSE_NETWORKS to a" in said


def test_if_the_folder_cannot_be_written_the_error_says_how_to_name_another(
    mine, entry, server, monkeypatch, refused
):
    monkeypatch.setenv("HUEPOSE_NETWORKS", "/proc/networks")
    said = refused(["models", "add", mine])
    assert "/proc/networks: found No such file or directory; expected a folder that can be" in said
    assert said.endswith("Set HUEPOSE_NETWORKS to one.\n")
    with pytest.raises(InputError, match="Set HUEPOSE_NETWORKS to one"):
        fetch(replace(entry, path=Path("/proc/networks/known.onnx")), server.url)


def test_an_unknown_name_is_answered_with_the_known_ones(tmp_path):
    config = parse("detector: {kind: yolo, model: yolo-nano, classes: {mug: 0}}", tmp_path / "p.yaml")
    with pytest.raises(InputError, match=r"expected one of yolox-nano, nanosam-encoder"):
        deployed.check(config)


def test_paths_are_relative_to_the_file_and_digests_by_file_name(mine, tmp_path):
    text = "detector: {{kind: yolo, model: {}, classes: {{mug: 0}}}}\nnetworks: {{sha256: {{{}: {}}}}}"
    right = hashlib.sha256(mine.read_bytes()).hexdigest()
    deployed.check(parse(text.format(mine.name, mine.name, right), tmp_path / "p.yaml"))
    with pytest.raises(InputError, match="expected " + "0" * 64):
        deployed.check(parse(text.format(mine.name, mine.name, "'" + "0" * 64 + "'"), tmp_path / "p.yaml"))
    for name in (f"{tmp_path.name}/{mine.name}", str(mine), "Mine.v3.onnx"):  # none of them would be compared
        with pytest.raises(InputError, match=rf"found {name}; expected .*Did you mean 'Mine.v2.onnx'"):
            deployed.check(parse(text.format(mine, name, right), tmp_path / "p.yaml"))


def test_a_provider_that_is_not_installed_is_refused_before_a_worker_needs_it(mine, tmp_path):
    yolo = f"detector: {{kind: yolo, model: {mine.name}, classes: {{mug: 0}}}}\n"
    missing = next(key for key, name in PROVIDERS.items() if name not in ort.get_available_providers())
    deployed.check(parse(f"{yolo}networks: {{providers: [{missing}, cpu]}}", tmp_path / "p.yaml"))
    with pytest.raises(InputError, match=f"execution providers .* expected one of {missing}. Add cpu"):
        deployed.check(parse(f"{yolo}networks: {{providers: [{missing}]}}", tmp_path / "p.yaml"))
    deployed.check(parse(f"networks: {{providers: [{missing}]}}", tmp_path / "p.yaml"))


def test_without_classes_those_with_the_names_of_objects_are_used(tmp_path):
    names = {"names": "{0: 'mug', 1: 'jug'}"}
    networks.constant_output(tmp_path / "named.onnx", np.zeros((1, 30, 6)), metadata=names)
    networks.constant_output(tmp_path / "nameless.onnx", np.zeros((1, 30, 6)))
    text = "detector: {{kind: yolo, model: {}.onnx}}\nobjects: [{}]"
    detector, _ = deployed.yolo(parse(text.format("named", "{name: jug}"), tmp_path / "p.yaml"))
    assert deployed.never_boxed(detector, ["jug", "mug"]) == "", "one that is added later has its class, too"
    assert "no class for pan, so" in deployed.never_boxed(detector, ["jug", "pan"])
    deployed.check(parse(text.format("named", ""), tmp_path / "p.yaml"))
    with pytest.raises(InputError, match=r"found none called muug, pan, but mug, jug;.* example {muug: mug}"):
        deployed.check(parse(text.format("named", "{name: muug}, {name: pan}"), tmp_path / "p.yaml"))
    with pytest.raises(InputError, match="no names in the file"):
        deployed.check(parse(text.format("nameless", ""), tmp_path / "p.yaml"))


def test_sam_without_files_takes_nanosam(tmp_path, folder):
    with pytest.raises(InputError, match="nanosam-encoder"):
        deployed.check(parse("segmenter: {kind: sam}", tmp_path / "p.yaml"))
    folder.mkdir()
    networks.sam_encoder(folder / "nanosam-encoder.onnx")
    networks.sam_decoder(folder / "nanosam-decoder.onnx")
    with pytest.raises(InputError, match="SHA-256"):  # the true encoder's digest is known
        deployed.check(parse("segmenter: {kind: sam}", tmp_path / "p.yaml"))


def test_sam_is_checked_too(tmp_path):
    networks.sam_encoder(tmp_path / "encoder.onnx")
    networks.sam_decoder(tmp_path / "decoder.onnx")
    text = "camera: {{truth: true}}\nsegmenter: {{kind: sam, encoder: {}.onnx, decoder: {}.onnx}}"
    deployed.check(parse(text.format("encoder", "decoder"), tmp_path / "p.yaml"))
    with pytest.raises(InputError, match="expected one input 1 x 3 x 1024"):
        deployed.check(parse(text.format("decoder", "encoder"), tmp_path / "p.yaml"))


def test_a_network_for_flow_is_checked(tmp_path):
    networks.blue_follower(tmp_path / "flow.onnx", 64, 96)
    networks.identity(tmp_path / "other.onnx", (1, 3, 64, 64))
    assert isinstance(deployed.flow(str(tmp_path / "flow.onnx")), NetworkFlow)
    with pytest.raises(InputError, match="two inputs of float"):
        deployed.flow(str(tmp_path / "other.onnx"))
    with pytest.raises(InputError, match="neuflow-v2"):
        deployed.flow("neuflow-v2")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("detector: {kind: yolo}", "detector.model"),
        (
            "detector: {kind: yolo, model: a.onnx, classes: {cup: 0}}\nobjects: [{name: mug}]",
            "one of objects: mug",
        ),
        ("camera: {truth: true}\nsegmenter: {kind: sam, encoder: a.onnx}", "segmenter.decoder"),
        ("camera: {source: oak, path: x}", "camera.path"),
        ("camera: {source: realsense, rate: recorded}", "camera.rate"),
        ("camera: {source: realsense, truth: true}", "camera.truth"),
        ("camera: {device: {width: 320}}", "camera.device"),
        ("networks: {providers: []}", "networks.providers"),
        ("networks: {sha256: {a.onnx: abc}}", "sha256"),
    ],
)
def test_sections_that_do_not_make_sense_are_refused(tmp_path, text, says):
    with pytest.raises(InputError) as error:
        parse(text, tmp_path / "p.yaml")
    assert says in str(error.value)

"""The files of `huepose secure` admit the right readers, and a reader's certificate can be revoked."""

import os
import shlex
import socket
import ssl
import stat
import threading
from contextlib import contextmanager, suppress

import pytest
import yaml

from huepose.support.errors import InputError
from huepose_protos import PoseClient
from huepose_protos.reach import why_unreachable
from huepose_services.authority import Authority
from huepose_services.cli.main import main
from huepose_services.pem import Credentials
from tests.services.conftest import parse

from .conftest import credentials, tls


def test_the_printed_section_is_a_configuration_with_existing_files(tmp_path, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = printed(["secure", "init", "--host", "robot.local", "--host", "10.0.0.7"])
    section = text[text.index("gateway:\n") : text.index("Then, for each")]
    config = parse(section, tmp_path / "pipeline.yaml")
    assert yaml.safe_load(section).keys() == {"gateway"}
    tls = config.gateway.tls
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=tls.authority)
    context.load_cert_chain(tls.certificate, tls.key)
    context.load_verify_locations(cafile=tls.revoked)
    assert _names(tls.certificate) == (("DNS", "robot.local"), ("IP Address", "10.0.0.7"))


def test_the_next_command_that_is_printed_finds_the_folder(tmp_path, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for options in ([], ["--folder", "the keys/secure"]):
        text = printed(["secure", "init", "--host", "robot.local", *options])
        command = shlex.split(text.splitlines()[-1].removeprefix("Then, for each reader: huepose "))
        assert main(["arm" if word == "NAME" else word for word in command]) == 0


def test_the_use_as_reader_and_as_second_computer_are_both_explained(tmp_path, printed, monkeypatch):
    monkeypatch.chdir(tmp_path)
    printed(["secure", "init", "--host", "robot.local"])
    said = printed(["secure", "add", "desk"])
    reader, second = said.splitlines()[-2:]
    assert reader.startswith("There, as a reader: huepose poses --gateway HOST --tls authority.pem desk.pem")
    assert second.startswith("There, as the second computer of a pipeline (`hosts`): put them in the folder")


def test_an_address_that_no_reader_can_use_is_noted(tmp_path, capsys):
    folder = str(tmp_path / "secure")
    assert main(["secure", "init", "--folder", folder, "--host", "fd00::2", "--host", "10.0.0.7"]) == 0
    assert (
        "note: readers cannot reach the IPv6 address fd00::2 over TLS: give a name" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    "host", ["https://robot", "tcp/robot.local", "robot.local:7447", "[::1]", "", "roböt"]
)
def test_a_host_is_a_name_or_an_address_alone(host, tmp_path, capsys):
    folder = tmp_path / "secure"
    assert main(["secure", "init", "--folder", str(folder), "--host", host]) == 2
    assert "expected a computer's name or address alone" in capsys.readouterr().err
    assert not folder.exists()


def test_only_their_user_can_read_keys(tmp_path):
    authority = Authority.make(tmp_path / "secure", ["localhost"], 30)
    authority.add("arm", 30)
    assert stat.S_IMODE((tmp_path / "secure").stat().st_mode) == 0o700
    assert {stat.S_IMODE(path.stat().st_mode) for path in (tmp_path / "secure").iterdir()} == {0o600}


def _names(certificate):
    return ssl._ssl._test_decode_cert(str(certificate))["subjectAltName"]


@contextmanager
def _listens(folder):
    """The port of a server with the gateway's certificate, which sends a byte to each client that it
    accepts."""
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=folder / "authority.pem")
    context.load_cert_chain(folder / "gateway.pem", folder / "gateway.key")
    context.verify_mode = ssl.CERT_REQUIRED
    server = socket.create_server(("127.0.0.1", 0))

    def let_in():
        with suppress(OSError):  # once it is shut down
            while True:
                link, _ = server.accept()
                with link, suppress(OSError), context.wrap_socket(link, server_side=True) as secured:
                    secured.sendall(b"!")

    thread = threading.Thread(target=let_in)
    thread.start()
    yield server.getsockname()[1]
    server.shutdown(socket.SHUT_RDWR)
    server.close()
    thread.join()


@pytest.mark.skipif(os.getuid() != 0, reason="only root writes for another user")
def test_what_root_revokes_can_be_read_by_the_user_of_the_services(tmp_path):
    """The gateway reads the list as that user, who owns the folder."""
    authority = Authority.make(tmp_path / "secure", ["localhost"], 30)
    authority.add("arm", 30)
    for path in (authority.folder, *authority.folder.iterdir()):
        os.chown(path, 65534, 65534)
    secret = tmp_path / "secret"
    secret.write_text("of root")
    (authority.folder / "revoked.pem.new").symlink_to(secret)
    authority.revoke("arm")
    authority.add_hosts(["robot.local"], 30)
    assert {path.stat().st_uid for path in authority.folder.iterdir()} == {65534}
    assert (secret.read_text(), secret.stat().st_uid) == ("of root", 0)


def test_another_name_of_the_gateway_gets_a_certificate_that_readers_accept(tmp_path, capsys):
    folder = tmp_path / "secure"
    authority = Authority.make(folder, ["robot.local", "10.0.0.7"], 30)
    authority.add("arm", 30)
    reader = Credentials(*(folder / name for name in ("authority.pem", "arm.pem", "arm.key")))
    kept = {path: path.read_bytes() for path in folder.iterdir() if path.stem != "gateway"}
    with _listens(folder) as port:
        assert why_unreachable("127.0.0.1", port, reader.context()) == (
            "its certificate is for robot.local, 10.0.0.7, not for 127.0.0.1: use such a name, or run "
            "`huepose secure host 127.0.0.1` on the gateway's computer"
        )
    assert main(["secure", "host", "127.0.0.1", "10.0.0.7", "--folder", str(folder)]) == 0
    assert "now for robot.local, 10.0.0.7, 127.0.0.1." in capsys.readouterr().out
    assert _names(folder / "gateway.pem") == (
        ("DNS", "robot.local"),
        ("IP Address", "10.0.0.7"),
        ("IP Address", "127.0.0.1"),
    )
    assert {path: path.read_bytes() for path in kept} == kept
    with _listens(folder) as port:
        assert why_unreachable("127.0.0.1", port, reader.context()) is None


def test_an_invalid_host_leaves_the_certificate_unchanged(tmp_path, capsys):
    folder = tmp_path / "secure"
    Authority.make(folder, ["robot.local"], 30)
    before = (folder / "gateway.pem").read_bytes()
    assert main(["secure", "host", "tcp/robot", "--folder", str(folder)]) == 2
    assert "expected a computer's name or address alone" in capsys.readouterr().err
    assert (folder / "gateway.pem").read_bytes() == before


@pytest.mark.parametrize("name", ["", "Arm", "../arm", "arm/..", "authority", "gateway", "revoked", "a" * 65])
def test_an_invalid_name_of_a_reader_is_refused(tmp_path, name):
    folder = tmp_path / "secure"
    Authority.make(folder, ["localhost"], 30)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    for action in ("add", "revoke"):
        assert main(["secure", action, name, "--folder", str(folder)]) == 2
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    assert [path.name for path in tmp_path.iterdir()] == ["secure"]


def test_nothing_is_overwritten(tmp_path, refused):
    folder = str(tmp_path / "secure")
    assert "huepose secure init" in refused(["secure", "add", "arm", "--folder", folder])
    assert main(["secure", "init", "--folder", folder]) == 0
    assert main(["secure", "init", "--folder", folder]) == 2
    assert main(["secure", "add", "arm", "--folder", folder]) == 0
    assert "huepose secure revoke arm first" in refused(["secure", "add", "arm", "--folder", folder])
    assert "one of: arm" in refused(["secure", "revoke", "leg", "--folder", folder])
    assert main(["secure", "init", "--folder", str(tmp_path / "x"), "--host", "ä"]) == 2
    assert "found 0, expected 1 to 36500" in refused(["secure", "init", "--folder", folder, "--days", "0"])


@pytest.mark.parametrize("name", ["authority.pem", "authority.key", "revoked.pem"])
def test_damaged_files_are_named(tmp_path, name):
    authority = Authority.make(tmp_path / "secure", ["localhost"], 30)
    authority.add("arm", 30)
    (authority.folder / name).write_text("-----BEGIN nonsense")
    with pytest.raises(InputError, match=name):
        Authority(authority.folder).revoke("arm")


@pytest.mark.live
def test_a_reader_is_let_in_while_the_gateway_runs_and_sent_away_again(start, tmp_path, wait_until):
    folder = tmp_path / "secure"
    authority = Authority.make(folder, ["localhost", "127.0.0.1"], 30)
    one = start(tls=tls(folder))
    address = f"tls/localhost:{one.port}"
    authority.add("arm", 30)
    authority.add("leg", 30)
    (tmp_path / "kept").mkdir()
    for path in folder.iterdir():  # the reader has its files elsewhere
        (tmp_path / "kept" / path.name).write_bytes(path.read_bytes())
    arm, leg = (PoseClient(address, **credentials(tmp_path / "kept", name)) for name in ("arm", "leg"))
    with arm, leg:
        one.say_until(lambda: arm.latest() and leg.latest())
        assert main(["secure", "revoke", "arm", "--folder", str(folder)]) == 0
        refused = one.work._door.refused
        # The other reader connects again, and goes on.
        one.say_until(lambda: one.work._door.refused > refused + 1 and leg.connected and not arm.connected)
        last = one.say(5000)
        wait_until(lambda: leg.latest().frame_id == last.frame_id)
        assert arm.latest().frame_id < last.frame_id
        # Another certificate of the same name is accepted: the certificate was revoked, not the name.
        authority.add("arm", 30)
        with PoseClient(address, **credentials(folder, "arm")) as again:
            one.say_until(lambda: again.latest() is not None)


@pytest.mark.live
def test_damaged_certificates_leave_the_old_ones_in_use(start, tmp_path, capfd):
    folder = tmp_path / "secure"
    authority = Authority.make(folder, ["localhost", "127.0.0.1"], 30)
    authority.add("arm", 30)
    one = start(tls=tls(folder))
    with PoseClient(f"tls/localhost:{one.port}", **credentials(folder, "arm")) as arm:
        one.say_until(lambda: arm.latest() is not None)
        (folder / "gateway.pem").write_text("nonsense")
        one.say_until(lambda: "old ones stay in use" in capfd.readouterr().err)
        assert arm.connected

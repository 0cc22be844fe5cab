"""Who can read through the gateway and who cannot, with a real certificate authority; and the reasons
given."""

import socket
import time
from contextlib import suppress
from datetime import datetime, timedelta, timezone
from pathlib import Path

import msgspec
import pytest
import zenoh

from huepose.support.errors import InputError
from huepose_protos import PoseClient, encode
from huepose_protos.client import open_session
from huepose_protos.examples import example
from huepose_protos.messages import CorrectionMessage
from huepose_protos.reach import fault_of, why_unreachable
from huepose_services.authority import Authority
from huepose_services.gateway_door import Door, check_door
from huepose_services.pem import Credentials
from huepose_services.runtime.config import Config, GatewayConfig

from .conftest import credentials, tls

pytestmark = pytest.mark.live


def test_only_the_authoritys_certificates_read(start, authority):
    one = start(tls=tls(authority))
    clients = {
        name: PoseClient(f"tls/localhost:{one.port}", **credentials(authority, name))
        for name in ("robot1", "robot2", "stranger", None)
    }
    clients["no TLS"] = PoseClient(f"tcp/localhost:{one.port}")
    one.say_until(lambda: clients["robot1"].latest() and clients["robot2"].latest())
    # Time for the others to get something.
    for i in range(60):
        one.say(7000 + i)
        time.sleep(0.01)
    heard = {name for name, client in clients.items() if client.latest() is not None}
    for client in clients.values():
        client.close()
    assert heard == {"robot1", "robot2"}


def test_only_listed_names_read_and_a_reader_cannot_steer(start, authority):
    one = start(tls=tls(authority, ["robot1"]))
    address = f"tls/localhost:{one.port}"
    listed = PoseClient(address, **credentials(authority, "robot1"))
    unlisted = PoseClient(address, **credentials(authority, "robot2"))
    steering = open_session([address], **credentials(authority, "robot1"))
    one.say_until(lambda: listed.latest() is not None and one.work._door.refused > 0)
    for _ in range(30):
        steering.put(one.tracker.keys.correction, encode(example(CorrectionMessage)))
        one.say(7000)
        time.sleep(0.01)
    for reply in steering.get(one.tracker.keys.control, timeout=0.5):
        pytest.fail(f"control answered: {reply}")
    assert unlisted.latest() is None
    assert not unlisted.connected
    assert one.tracker.take(one.corrections, CorrectionMessage) is None
    for client in (listed, unlisted, steering):
        client.close()


def test_a_reload_replaces_the_permitted_readers(start, authority):
    one = start(tls=tls(authority, ["robot1"]))
    address = f"tls/localhost:{one.port}"
    with (
        PoseClient(address, **credentials(authority, "robot1")) as before,
        PoseClient(address, **credentials(authority, "robot2")) as after,
    ):
        one.say_until(lambda: before.latest() is not None and one.work._door.refused > 0)
        gateway = GatewayConfig(listen="0.0.0.0:1", max_rate_hz=7.0, tls=tls(authority, ["robot2"]))
        assert one.work.reload(Config(gateway=gateway)) == []
        one.say_until(lambda: after.latest() is not None and not before.connected)


def test_the_reason_why_a_gateway_is_not_reached_is_given(start, authority, base_port, monkeypatch):
    one = start(tls=tls(authority))
    shown = {name: Credentials(*credentials(authority, name).values()) for name in ("robot1", "stranger")}
    shown["no authority"] = shown["robot1"]._replace(authority=authority / "robot2.pem")
    reasons = {name: why_unreachable("localhost", one.port, files.context()) for name, files in shown.items()}
    assert reasons["robot1"] is None
    assert "does not accept this certificate" in reasons["stranger"]
    assert reasons["no authority"] == "its certificate is not accepted: another authority signed it"
    assert "give authority, certificate and key" in why_unreachable("localhost", one.port, None)
    assert why_unreachable("localhost", base_port + 8, None) == "no program listens there"
    address = f"localhost:{one.port}"
    for given, files, found in (
        (f"tls/{address}", credentials(authority, "stranger"), "does not accept this certificate"),
        (f"tls/{address}", credentials(authority, "stranger"), "alone: another authority signed it"),
        (f"tcp/{address}", {}, "give authority, certificate and key"),
    ):
        with PoseClient(given, **files) as client:
            assert client.why_silent().startswith(f"waiting for a gateway at {given}: it ")
            assert found in client.why_silent()
    monkeypatch.setattr("huepose_protos.reach._WITHIN_S", 0.5)  # it never answers
    with socket.create_server(("127.0.0.1", base_port + 1)):
        assert "without --tls" in why_unreachable("127.0.0.1", base_port + 1, shown["robot1"].context())


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--gateway", "a b"], "expected HOST or HOST:PORT"),
        (["--tls", "{0}/authority.pem", "{0}/robot1.pem", "{0}/robot1.key"], "no --gateway"),
        (["--gateway", "x", "--tls", "{0}/authority.pem", "{0}/robot1.pem", "{0}/nothing"], "--tls key"),
        (
            ["--gateway", "x", "--tls", "{0}/authority.pem", "{0}/robot1.pem", "{0}/robot2.key"],
            "a key of another certificate; expected",
        ),
        (
            ["--gateway", "x", "--tls", "{0}/authority.pem", "{0}/robot1.key", "{0}/robot1.pem"],
            "robot1.key: found PRIVATE KEY; expected a certificate in PEM",
        ),
    ],
)
def test_gateway_options_that_cannot_work_are_refused(authority, refused, options, said):
    assert said in refused(["poses", *(option.format(authority) for option in options)])


def test_an_invalid_revocation_list_is_refused(authority):
    """With it no reader at all could connect."""
    given = msgspec.structs.replace(tls(authority), revoked=str(authority / "authority.pem"))
    with pytest.raises(InputError, match=r"gateway\.tls\.revoked .*found CERTIFICATE; expected a list"):
        check_door(GatewayConfig(listen="127.0.0.1:1", tls=given))


@pytest.mark.parametrize("address", ["192.0.2.7:7447", "[2001:db8::7]:7447"])
def test_a_gateway_waits_for_its_address(address):
    """A machine that starts without a network has no address yet; an input error would end the worker for
    ever."""
    gateway, said = GatewayConfig(listen=address), []
    with pytest.raises(InputError, match="Cannot assign requested address; expected an address of this"):
        check_door(gateway)
    door = Door(gateway, Path("/nowhere"), lambda kind, text: said.append(text), 1000.0, "gateway")
    door.close()
    assert said == [f"gateway.listen {address}: no network here has that address yet, so nobody can connect"]


def test_the_log_says_why_each_kind_of_reader_is_refused(start, authority, wait_until, capsys):
    """Also if one goes on trying: a repeated reason is logged once, other reasons are logged too."""
    one = start(tls=tls(authority, ["robot1"]))
    expired = authority.parent / "expired"
    expired.mkdir(exist_ok=True)
    _expired(authority, expired)
    shown = [Credentials(*credentials(authority, name).values()) for name in ("robot2", "stranger")]
    shown.append(Credentials(authority / "authority.pem", expired / "old.pem", expired / "old.key"))
    for _ in range(5):
        with socket.create_connection(("127.0.0.1", one.port)) as link:
            link.sendall(b"GET / HTTP/1.1\r\n\r\n")
            with suppress(ConnectionError):
                link.recv(1)
    for files in shown:
        assert "its log says why" in why_unreachable("localhost", one.port, files.context())
    # A reader on another machine finds the same reason itself, if possible.
    assert [fault_of(*files) for files in shown] == [
        None,
        "another authority signed it",
        "certificate has expired",
    ]
    wait_until(lambda: one.work._door.refused >= 8)
    log = capsys.readouterr().err
    for why in (
        "127.0.0.1: it speaks without TLS",
        "robot2 is not one of gateway.tls.readers",
        "127.0.0.1: its certificate is not accepted: another authority signed it",
        "127.0.0.1: its certificate is not accepted: certificate has expired",
    ):
        assert log.count(f"a reader is refused: {why}") == 1, log


def _expired(authority, folder):
    """A certificate of the authority, `old`, that was valid until yesterday."""
    with pytest.MonkeyPatch.context() as patch:
        before = datetime.now(timezone.utc) - timedelta(days=2)
        patch.setattr("huepose_services.authority._now", lambda: before)
        Authority(authority).add("old", 1)
    for name in ("old.pem", "old.key"):
        (authority / name).rename(folder / name)


@pytest.mark.parametrize("name", ["authority", "certificate", "key"])
def test_missing_files_are_named(base_port, authority, name):
    from huepose_services.gateway_session import open_outside

    broken = msgspec.structs.replace(tls(authority), **{name: str(authority / "nothing.pem")})
    with pytest.raises(InputError, match=f"gateway.tls.{name}.*No such file"):
        open_outside(GatewayConfig(listen=f"127.0.0.1:{base_port}", tls=broken), print)


def test_an_open_port_without_tls_gives_a_warning(base_port):
    from huepose_services.gateway_session import open_outside

    session, door, warning = open_outside(GatewayConfig(listen=f"0.0.0.0:{base_port}"), print)
    door.close()
    session.close()
    assert "anyone who reaches" in warning
    assert isinstance(session, zenoh.Session)

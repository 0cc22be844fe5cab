"""A small certificate authority for the gateway: the gateway's certificate, one for each reader, and the
list of revoked ones.

Its folder, which only its user can open, has `authority.pem` and `.key`, `gateway.pem` and `.key`,
`revoked.pem`, and `NAME.pem` and `.key` of each reader. Copy the reader's files to the reader's machine.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from huepose.support.errors import InputError
from huepose_protos.fields import is_name

AUTHORITY, GATEWAY, REVOKED = "authority", "gateway", "revoked"
_NAME = re.compile(r"(?!.{254})[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*")
"""The name of a computer in DNS, up to 253 characters."""
T = TypeVar("T")


class Authority:
    """The authority in a folder. Raises InputError if there is none, or its files are damaged."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        if not self.certificate(AUTHORITY).is_file():
            raise InputError(
                folder,
                found="no authority",
                expected=f"{AUTHORITY}.pem in it",
                fix="Make one: huepose secure init.",
            )
        self._certificate = _read(self.certificate(AUTHORITY), x509.load_pem_x509_certificate)
        key = _read(self.key(AUTHORITY), lambda data: serialization.load_pem_private_key(data, None))
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise InputError(self.key(AUTHORITY), found="another kind of key", expected="elliptic curve")
        self._key = key

    @staticmethod
    def make(folder: Path, hosts: Sequence[str], days: int) -> Authority:
        """Make a new authority, and the certificate of the gateway. hosts: names and addresses by which
        readers reach the gateway.

        Raises InputError for a folder that is not empty, and for a host that is neither a name nor an
        address."""
        reached_by = [*map(_host, hosts)]
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(folder, found="something there", expected="a new or empty folder")
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        folder.chmod(0o700)
        key = ec.generate_private_key(ec.SECP256R1())
        name = _name("huepose authority")
        builder = _builder(name, name, key, days)
        certificate = (
            builder.add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(signs=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        _write(folder / f"{AUTHORITY}.key", _pem(key))
        _write(folder / f"{AUTHORITY}.pem", certificate.public_bytes(serialization.Encoding.PEM))
        authority = Authority(folder)
        authority._issue(GATEWAY, reached_by, ExtendedKeyUsageOID.SERVER_AUTH, days)
        authority._revoke([])
        return authority

    def certificate(self, name: str) -> Path:
        """The file of the certificate of that name."""
        return self.folder / f"{name}.pem"

    def key(self, name: str) -> Path:
        """The file of the key of that name."""
        return self.folder / f"{name}.key"

    def add(self, name: str, days: int) -> None:
        """Make a certificate for a reader. Raises InputError for a name that is taken or not valid."""
        if not is_name(name) or name in (AUTHORITY, GATEWAY, REVOKED):
            raise InputError(
                name,
                found="not a valid name for a reader",
                expected="up to 64 of a-z, 0-9, _ and -; not authority, gateway or revoked",
            )
        if self.certificate(name).exists():
            raise InputError(
                self.certificate(name),
                found="a certificate of that name",
                fix=f"huepose secure revoke {name} first.",
            )
        self._issue(name, [], ExtendedKeyUsageOID.CLIENT_AUTH, days)

    def add_hosts(self, hosts: Sequence[str], days: int) -> list[str]:
        """Make the gateway's certificate again, with more names and addresses by which readers reach it.
        Returns all of them, old and new. The readers' certificates stay as they are. Raises InputError for
        a host that is neither a name nor an address."""
        before = _read(self.certificate(GATEWAY), x509.load_pem_x509_certificate)
        named = before.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        reached_by = list(dict.fromkeys([*named, *map(_host, hosts)]))
        self._issue(GATEWAY, reached_by, ExtendedKeyUsageOID.SERVER_AUTH, days)
        return [str(host.value) for host in reached_by]

    def revoke(self, name: str) -> None:
        """Revoke the certificate of a reader, and delete its files here. Raises InputError if there is no
        such reader."""
        if not is_name(name) or name in (AUTHORITY, GATEWAY, REVOKED) or not self.certificate(name).is_file():
            readers = sorted(path.stem for path in self.folder.glob("*.key"))
            known = ", ".join(n for n in readers if n not in (AUTHORITY, GATEWAY))
            raise InputError(name, found="no reader of that name", expected=f"one of: {known or 'none'}")
        serial = _read(self.certificate(name), x509.load_pem_x509_certificate).serial_number
        before = _read(self.certificate(REVOKED), x509.load_pem_x509_crl)
        self._revoke([*(entry.serial_number for entry in before), serial])
        self.key(name).unlink(missing_ok=True)
        self.certificate(name).unlink()

    def _issue(self, name: str, hosts: list[x509.GeneralName], use: x509.ObjectIdentifier, days: int) -> None:
        key = ec.generate_private_key(ec.SECP256R1())
        builder = (
            _builder(_name(name), self._certificate.subject, key, days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(signs=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage([use]), critical=False)
            .add_extension(x509.SubjectAlternativeName(hosts or [x509.DNSName(name)]), critical=False)
        )
        certificate = builder.sign(self._key, hashes.SHA256())
        _write(self.key(name), _pem(key))
        _write(self.certificate(name), certificate.public_bytes(serialization.Encoding.PEM))

    def _revoke(self, serials: list[int]) -> None:
        now = _now()
        builder = x509.CertificateRevocationListBuilder(
            self._certificate.subject, now, self._certificate.not_valid_after_utc
        )
        for serial in serials:
            entry = x509.RevokedCertificateBuilder(serial, now).build()
            builder = builder.add_revoked_certificate(entry)
        revoked = builder.sign(self._key, hashes.SHA256())
        _write(self.certificate(REVOKED), revoked.public_bytes(serialization.Encoding.PEM))


def _now() -> datetime.datetime:
    return datetime.datetime.now(datetime.timezone.utc)


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    # The clocks of two machines are never exactly the same.
    begin = _now() - datetime.timedelta(hours=1)
    return x509.CertificateBuilder(
        issuer,
        subject,
        key.public_key(),
        x509.random_serial_number(),
        begin,
        begin + datetime.timedelta(days),
    )


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _host(text: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(text))
    except ValueError:
        pass
    if not _NAME.fullmatch(text):
        raise InputError(
            "a host",
            found=text[:80] or "nothing",
            expected="a computer's name or address alone, without tcp/, https:// and port",
        )
    return x509.DNSName(text)


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _write(path: Path, data: bytes) -> None:
    """Write all of a file or nothing; only its user can read it. Root writes for the folder's user, as whom
    a gateway may run."""
    fresh, folder = path.with_name(path.name + ".new"), path.parent.stat()
    fresh.unlink(missing_ok=True)
    # Not through a link that this user has put there.
    with os.fdopen(os.open(fresh, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
        if os.geteuid() == 0:
            os.fchown(file.fileno(), folder.st_uid, folder.st_gid)
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    fresh.replace(path)


def _read(path: Path, load: Callable[[bytes], T]) -> T:
    try:
        return load(path.read_bytes())
    except OSError as error:
        raise InputError(path, found=error.strerror or str(error), expected="a readable file") from None
    except (ValueError, TypeError) as error:
        raise InputError(
            path, found=str(error)[:200], expected="PEM as huepose secure init writes it"
        ) from None

"""A private certificate authority: one certificate per host, node and user.

    <folder>/ca.pem, ca.key                   the authority; its key never leaves this folder
    <folder>/<identity>/ca.pem, own.pem, own.key   what a host, node or user needs
    <folder>/user.<name>/addresses.json          addresses of the hosts: label -> address

The common name of a certificate is the identity of its owner: `host.<label>`,
`node.<graph>.<process>` or `user.<name>` (`pipeline.fleet.names`). The access lists of
`pipeline.fleet.links` use these names, never addresses.
"""

from __future__ import annotations

import datetime
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pipeline.errors import RunError, SettingsError
from pipeline.extras import LateModule
from pipeline.fleet.names import check_identity
from pipeline.whole_file import write_whole

if TYPE_CHECKING:
    from cryptography import x509
    from cryptography.hazmat.primitives import hashes, serialization
    from cryptography.hazmat.primitives.asymmetric import ec
    from cryptography.x509 import oid
else:  # an optional package, slower to load than all the rest of a command
    x509, oid = LateModule("cryptography.x509"), LateModule("cryptography.x509.oid")
    hashes = LateModule("cryptography.hazmat.primitives.hashes")
    serialization = LateModule("cryptography.hazmat.primitives.serialization")
    ec = LateModule("cryptography.hazmat.primitives.asymmetric.ec")

AUTHORITY_DAYS = 3650
CERTIFICATE_DAYS = 825
RENEWAL = datetime.timedelta(days=90)  # before the expiry
SKEW = datetime.timedelta(days=1)  # a host whose clock is behind must accept its own certificate
COMMON_NAME = "fovea authority"
ADDRESSES = "addresses.json"


@dataclass(frozen=True)
class Credentials:
    """The three files that prove an identity and verify others."""

    folder: Path

    @staticmethod
    def of(folder: Path) -> Credentials:
        """Return a folder's credentials; raises `SettingsError` if incomplete or not private."""
        credentials = Credentials(folder)
        for path in (credentials.authority, credentials.certificate, credentials.key):
            if not path.is_file():
                raise SettingsError(f"{path}: expected a file made by `fovea secure`, got none")
        if credentials.key.stat().st_mode & 0o077:
            expected = "expected a key only its owner can read (mode 600)"
            raise SettingsError(f"{credentials.key}: {expected}")
        return credentials

    @property
    def authority(self) -> Path:
        """The certificate of the authority."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """The certificate with the identity."""
        return self.folder / "own.pem"

    @property
    def key(self) -> Path:
        """The private key."""
        return self.folder / "own.key"

    @property
    def identity(self) -> str:
        """The common name; raises `SettingsError` for an invalid certificate."""
        return identity_of(self.certificate)


def create(folder: Path) -> None:
    """Create the authority; raises `RunError` where there already is one."""
    if (folder / "ca.pem").exists():
        raise RunError(
            f"{folder}: expected a folder without an authority, got one with ca.pem; `fovea secure "
            "add` makes credentials below it"
        )
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    key = _key(folder / "ca.key")
    name = _name(COMMON_NAME)
    certificate = (
        _draft(name, name, key, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    _publish(folder / "ca.pem", certificate)


def issue(own: Path, folder: Path, identity: str, days: int = CERTIFICATE_DAYS) -> Credentials:
    """Create key and certificate of an identity in its own folder, unless they exist.

    The certificate is written last, so that the next call completes an interrupted one. Raises
    `SettingsError` for a name that does not fit a certificate.
    """
    if not all(path.exists() for path in _files(own)):
        _certify(own, folder, check_identity(identity), days)
    return Credentials.of(own)


def renew(folder: Path) -> Iterator[str]:
    """Renew credentials of an authority that expire soon, for the same keys."""
    for path in sorted(folder.rglob("own.pem")):
        ends = _certificate(path).not_valid_after_utc
        if ends - datetime.datetime.now(datetime.UTC) < RENEWAL:
            _certify(path.parent, folder, identity_of(path), CERTIFICATE_DAYS)
            yield (
                f"{path.parent}: renewed for {CERTIFICATE_DAYS} days, as it expires on "
                f"{ends:%Y-%m-%d}; copy it to its host or user again"
            )


def identity_of(certificate: Path) -> str:
    """Return the common name of a certificate; raises `SettingsError` for an invalid one."""
    names = _certificate(certificate).subject.get_attributes_for_oid(oid.NameOID.COMMON_NAME)
    if not names:
        raise SettingsError(f"{certificate}: expected a certificate with a common name, got none")
    return str(names[0].value)


def _certificate(path: Path) -> x509.Certificate:
    try:
        return x509.load_pem_x509_certificate(path.read_bytes())
    except (OSError, ValueError) as error:
        raise SettingsError(f"{path}: expected a certificate, got none: {error}") from error


def _files(own: Path) -> tuple[Path, ...]:
    credentials = Credentials(own)
    return credentials.key, credentials.authority, credentials.certificate


def _certify(own: Path, folder: Path, identity: str, days: int) -> None:
    authority, authority_key = _authority(folder)
    own.mkdir(mode=0o700, parents=True, exist_ok=True)
    key = _key(own / "own.key")
    certificate = (
        _draft(_name(identity), authority.subject, key, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage(
                [oid.ExtendedKeyUsageOID.SERVER_AUTH, oid.ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(identity)]), critical=False)
        .sign(authority_key, hashes.SHA256())
    )  # fmt: skip
    write_whole(own / "ca.pem", (folder / "ca.pem").read_bytes())
    _publish(own / "own.pem", certificate)


def _key(path: Path) -> ec.EllipticCurvePrivateKey:
    """Return the existing key or a new one; raises `SettingsError` for another kind of file."""
    if not path.exists():
        key = ec.generate_private_key(ec.SECP256R1())
        write_whole(path, _private(key), secret=True)  # never readable by others
        return key
    return _read_key(path)


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        return _certificate(folder / "ca.pem"), _read_key(folder / "ca.key")
    except SettingsError as error:
        raise SettingsError(
            f"{folder}: expected an authority made by `fovea secure init`: {error}"
        ) from error


def _read_key(path: Path) -> ec.EllipticCurvePrivateKey:
    try:
        key = serialization.load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError) as error:
        raise SettingsError(f"{path}: expected a private key, got none: {error}") from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise SettingsError(f"{path}: expected an elliptic-curve key, got another")
    return key


def _draft(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePrivateKey, days: int
) -> x509.CertificateBuilder:
    now = datetime.datetime.now(datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - SKEW)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _usage(*, signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs, key_cert_sign=signs, crl_sign=signs, content_commitment=False,
        key_encipherment=False, data_encipherment=False, key_agreement=False, encipher_only=False,
        decipher_only=False,
    )  # fmt: skip


def _name(common: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(oid.NameOID.COMMON_NAME, common)])


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _publish(path: Path, certificate: x509.Certificate) -> None:
    write_whole(path, certificate.public_bytes(serialization.Encoding.PEM))

"""A private certificate authority and what it signs: one certificate per box, node and person.

    <folder>/ca.pem, ca.key                   the authority; its key stays where it was made
    <folder>/<holder>/ca.pem, own.pem, own.key   what one holder needs, to be copied there
    <folder>/person.<name>/addresses.json        where the boxes are: label -> address

The common name of a certificate says who speaks: `box.<label>`, `node.<graph>.<process>` or
`person.<name>`. The access lists of `pipeline.fleet.access` go by these names, never by addresses.
"""

import datetime
import os
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from pipeline.errors import RunError, SettingsError

AUTHORITY_DAYS = 3650
HOLDER_DAYS = 825
SKEW = datetime.timedelta(days=1)  # a box whose clock is behind must not refuse its own
COMMON_NAME = "fovea authority"
ADDRESSES = "addresses.json"


@dataclass(frozen=True)
class Papers:
    """The three files that a holder shows and checks others by."""

    folder: Path

    @staticmethod
    def of(folder: Path) -> "Papers":
        """Those of a folder; raises `SettingsError` when one is missing or its key is readable."""
        papers = Papers(folder)
        for path in (papers.authority, papers.certificate, papers.key):
            if not path.is_file():
                raise SettingsError(f"{path}: expected a file made by `fovea secure`, got none")
        if papers.key.stat().st_mode & 0o077:
            raise SettingsError(f"{papers.key}: expected a key only its owner can read (mode 600)")
        return papers

    @property
    def authority(self) -> Path:
        """The certificate that all others are checked against."""
        return self.folder / "ca.pem"

    @property
    def certificate(self) -> Path:
        """Who the holder is."""
        return self.folder / "own.pem"

    @property
    def key(self) -> Path:
        """What proves it."""
        return self.folder / "own.key"

    @property
    def holder(self) -> str:
        """The common name; raises `SettingsError` for a file that is no certificate."""
        return holder_of(self.certificate)


def create(folder: Path) -> None:
    """Make the authority; raises `RunError` where there is one already."""
    if (folder / "ca.key").exists():
        raise RunError(f"{folder}: expected a folder without an authority, got one with ca.key")
    folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(COMMON_NAME)
    certificate = (
        _draft(name, name, key, AUTHORITY_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(signs=True), critical=True)
        .sign(key, hashes.SHA256())
    )
    _write(folder / "ca.key", _private(key))
    (folder / "ca.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))


def issue(own: Path, folder: Path, holder: str) -> Papers:
    """Make key and certificate of a holder in a folder of its own, unless it has them."""
    if (own / "own.key").exists():
        return Papers.of(own)
    authority, authority_key = _authority(folder)
    own.mkdir(mode=0o700, parents=True, exist_ok=True)
    key = ec.generate_private_key(ec.SECP256R1())
    certificate = (
        _draft(_name(holder), authority.subject, key, HOLDER_DAYS)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(signs=False), critical=True)
        .add_extension(
            x509.ExtendedKeyUsage(
                [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
            ),
            critical=False,
        )
        .add_extension(x509.SubjectAlternativeName([x509.DNSName(holder)]), critical=False)
        .sign(authority_key, hashes.SHA256())
    )  # fmt: skip
    _write(own / "own.key", _private(key))
    (own / "own.pem").write_bytes(certificate.public_bytes(serialization.Encoding.PEM))
    (own / "ca.pem").write_bytes((folder / "ca.pem").read_bytes())
    return Papers.of(own)


def holder_of(certificate: Path) -> str:
    """The common name of a certificate; raises `SettingsError` for a file that is none."""
    try:
        read = x509.load_pem_x509_certificate(certificate.read_bytes())
        return str(read.subject.get_attributes_for_oid(NameOID.COMMON_NAME)[0].value)
    except (OSError, ValueError, IndexError) as error:
        raise SettingsError(f"{certificate}: expected a certificate, got none: {error}") from error


def _authority(folder: Path) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey]:
    try:
        certificate = x509.load_pem_x509_certificate((folder / "ca.pem").read_bytes())
        key = serialization.load_pem_private_key((folder / "ca.key").read_bytes(), None)
    except (OSError, ValueError) as error:
        raise SettingsError(
            f"{folder}: expected an authority made by `fovea secure init`: {error}"
        ) from error
    if not isinstance(key, ec.EllipticCurvePrivateKey):
        raise SettingsError(f"{folder}/ca.key: expected an elliptic-curve key, got another")
    return certificate, key


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
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _private(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def _write(path: Path, secret: bytes) -> None:
    """Never readable by others, not even for a moment."""
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    with os.fdopen(handle, "wb") as file:
        file.write(secret)

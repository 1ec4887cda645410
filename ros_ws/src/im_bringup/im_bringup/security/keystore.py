"""Keystore of SROS 2: an authority, and an enclave a process, in the layout that rcl and ``ros2 security`` read."""

from collections.abc import Mapping
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
    pkcs7,
)

from im_bringup.security.permissions import Permissions, governance_document, permissions_document
from im_core import clock
from im_core.errors import DataError
from im_core.files import make_folder, read_bytes, write_whole

_MOST_BYTES = 1_000_000
_VALID_S = 3650 * 86400.0
_PUBLIC, _PRIVATE, _ENCLAVES = "public", "private", "enclaves"
_AUTHORITY = "sros2CA"
_ROLES = ("identity_ca", "permissions_ca")


class Keystore:
    """Keystore in a folder; made where there is none, and added to where there is one.

    Args:
        folder: The folder; of the user alone (mode 0700).
        domain: ROS domain of the governance and of all permissions.

    Raises:
        DataError: The folder holds something else, or an authority that cannot be read.
        StoreError: It cannot be written.
    """

    def __init__(self, folder: Path, domain: int) -> None:
        self._folder, self._domain = folder, domain
        private = folder / _PRIVATE / "ca.key.pem"
        if not private.is_file() and folder.is_dir() and any(folder.iterdir()):
            raise DataError(f"{folder} is neither empty nor a keystore: it has no {_PRIVATE}/ca.key.pem")
        for name in ("", _PUBLIC, _PRIVATE, _ENCLAVES):
            make_folder(folder / name, mode=0o700)
        if not private.is_file():
            self._make_authority(private)
        self._key, self._certificate = self._authority(private)
        self._write_signed(folder / _ENCLAVES / "governance", governance_document(domain))

    def add(self, enclaves: Mapping[str, Permissions]) -> None:
        """Write the enclaves: keys are kept where there are some, permissions are written anew."""
        for name, allowed in enclaves.items():
            folder = self._folder / _ENCLAVES / name.strip("/")
            make_folder(folder, mode=0o700)
            up = "../" * (len(name.strip("/").split("/")) + 1)
            for role in _ROLES:
                _link(folder / f"{role}.cert.pem", f"{up}{_PUBLIC}/{role}.cert.pem")
            _link(folder / "governance.p7s", f"{up}{_ENCLAVES}/governance.p7s")
            if not ((folder / "key.pem").is_file() and (folder / "cert.pem").is_file()):
                key, certificate = _certified(name, self._certificate.subject, self._key)
                write_whole(folder / "key.pem", _pem(key), own=True)
                write_whole(folder / "cert.pem", certificate.public_bytes(Encoding.PEM))
            own = x509.load_pem_x509_certificate(read_bytes(folder / "cert.pem", _MOST_BYTES))
            valid = tuple(f"{end:%Y-%m-%dT%H:%M:%S}" for end in (own.not_valid_before_utc, own.not_valid_after_utc))
            self._write_signed(folder / "permissions", permissions_document(name, allowed, self._domain, valid))

    def _make_authority(self, private: Path) -> None:
        key, certificate = _certified(_AUTHORITY)
        public = self._folder / _PUBLIC / "ca.cert.pem"
        write_whole(public, certificate.public_bytes(Encoding.PEM))
        for role in _ROLES:
            _link(public.with_name(f"{role}.cert.pem"), public.name)
            _link(private.with_name(f"{role}.key.pem"), private.name)
        write_whole(private, _pem(key), own=True)  # the last: a keystore with it is whole

    def _authority(self, private: Path) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
        public = self._folder / _PUBLIC / "ca.cert.pem"
        try:
            key = load_pem_private_key(read_bytes(private, _MOST_BYTES), None)
            certificate = x509.load_pem_x509_certificate(read_bytes(public, _MOST_BYTES))
        except (ValueError, TypeError) as error:
            raise DataError(f"the authority of keystore {self._folder} cannot be read: {error}") from error
        if not isinstance(key, ec.EllipticCurvePrivateKey):
            raise DataError(f"{private} is no key of an elliptic curve, which DDS Security and sros2 use")
        return key, certificate

    def _write_signed(self, path: Path, document: bytes) -> None:
        """Write a document as ``.xml``, and signed by the authority as ``.p7s`` (S/MIME, clear text)."""
        options = [pkcs7.PKCS7Options.Text, pkcs7.PKCS7Options.DetachedSignature]
        builder = pkcs7.PKCS7SignatureBuilder().set_data(document)
        signed = builder.add_signer(self._certificate, self._key, hashes.SHA256()).sign(Encoding.SMIME, options)
        write_whole(path.with_suffix(".xml"), document)
        write_whole(path.with_suffix(".p7s"), signed)


def _certified(
    name: str, issuer: x509.Name | None = None, authority: ec.EllipticCurvePrivateKey | None = None
) -> tuple[ec.EllipticCurvePrivateKey, x509.Certificate]:
    """Return a new key on P-256 with its certificate; without an issuer that of an authority."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(x509.oid.NameOID.COMMON_NAME, name)])
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer or subject)
        .serial_number(x509.random_serial_number())
        .not_valid_before(clock.utc())
        .not_valid_after(clock.utc(_VALID_S))
        .public_key(key.public_key())
        .add_extension(
            x509.BasicConstraints(ca=authority is None, path_length=1 if authority is None else None),
            critical=authority is None,
        )
        .sign(authority or key, hashes.SHA256())
    )
    return key, certificate


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())


def _link(path: Path, target: str) -> None:
    if not path.is_symlink():
        path.symlink_to(target)

"""Who wrote a result: its manifest, signed as `ssh-keygen -Y sign -n skd` signs a file, by a key of OpenSSH's.

The signature stands beside the manifest as `manifest.sha256.sig`; `ssh-keygen -Y verify -n skd` checks it as well. The
format is OpenSSH's (PROTOCOL.sshsig); keys are read, and used, by the package cryptography.
"""

from __future__ import annotations

import base64
import hashlib
import os
import struct
import textwrap
from pathlib import Path
from typing import Any

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric.padding import PKCS1v15
from cryptography.hazmat.primitives.asymmetric.rsa import RSAPublicKey
from cryptography.hazmat.primitives.hashes import SHA512
from skd_sim.errors import UsageError
from skd_sim.inputs.outside import read_bytes

NAMESPACE = b"skd"
"""What is signed by this name is a result; a signature that the key gave for something else does not count."""
_SUFFIX = ".sig"  # which ssh-keygen writes, too
_LARGEST = 64 * 1024  # bytes of a key or a signature; the longest that are used have some thousands
_MAGIC = b"SSHSIG"
_BEGIN, _END = "-----BEGIN SSH SIGNATURE-----", "-----END SSH SIGNATURE-----"


class Signer:
    """A private key that signs manifests."""

    def __init__(self, path: Path) -> None:
        """Read the key.

        Raises:
            UsageError: it is no private key of OpenSSH's, of another kind than Ed25519 and RSA, or has a password.
        """
        content = _key_in(path, "--sign")
        try:
            self._key = serialization.load_ssh_private_key(content, password=None)
        except TypeError as error:
            raise UsageError(
                f"--sign {path}: has a password, for which SKD does not ask; sign afterwards: "
                f"ssh-keygen -Y sign -n skd -f {path} manifest.sha256"
            ) from error
        except Exception as error:  # whatever the bytes make its reader raise
            raise UsageError(f"--sign {path}: is no private key as ssh-keygen writes it") from error
        self._public = _wire(self._key.public_key(), f"--sign {path}")

    def has_signed(self, path: Path) -> bool:
        """Return whether a file has a signature by this key; none is fine.

        Raises:
            UsageError: it has another one, or one that does not hold.
        """
        signature = path.with_name(path.name + _SUFFIX)
        if not signature.is_symlink() and not signature.exists():
            return False
        if fault := PublicKey.of(self).fault_of(path):
            raise UsageError(f"{fault}; move the signature away if this result is to be signed")
        return True

    def sign(self, path: Path) -> None:
        """Write the signature of a file beside it.

        Raises:
            OSError: it cannot be written.
        """
        message = _signed(hashlib.sha512(path.read_bytes()).digest())
        kind, *options = _algorithm(self._key.public_key())
        inside = _text(kind) + _text(self._key.sign(message, *options))
        blob = _MAGIC + struct.pack(">I", 1)
        blob += b"".join(map(_text, (self._public, NAMESPACE, b"", b"sha512", inside)))
        lines = textwrap.wrap(base64.b64encode(blob).decode(), 70)
        with path.with_name(path.name + _SUFFIX).open("w", encoding="ascii") as file:
            file.write("\n".join([_BEGIN, *lines, _END, ""]))
            file.flush()
            os.fsync(file.fileno())


class PublicKey:
    """A public key, against which signatures are held."""

    def __init__(self, path: Path) -> None:
        """Read the key.

        Raises:
            UsageError: it is no public key of OpenSSH's, or of another kind than Ed25519 and RSA.
        """
        content = _key_in(path, "--key")
        try:
            self._key = serialization.load_ssh_public_key(content)
        except Exception as error:  # whatever the bytes make its reader raise
            raise UsageError(f"--key {path}: is no public key as ssh-keygen writes it (….pub)") from error
        self._public = _wire(self._key, f"--key {path}")

    @classmethod
    def of(cls, signer: Signer) -> PublicKey:
        """Return the public key of one that signs."""
        made = cls.__new__(cls)
        made._key, made._public = signer._key.public_key(), signer._public
        return made

    def fault_of(self, path: Path) -> str:
        """Return why a file is not signed by this key, in one line; empty: it is."""
        signature = path.with_name(path.name + _SUFFIX)
        try:
            inside = self._inside(read_bytes(signature, _LARGEST))
            digest = hashlib.sha512(read_bytes(path)).digest()
        except UsageError as error:
            return str(error)
        except (ValueError, struct.error):
            return f"{signature}: is no signature of a result as `skd --sign` or `ssh-keygen -Y sign -n skd` makes it"
        if inside is None:
            return f"{signature}: is by another key"
        kind, *options = _algorithm(self._key)
        try:
            said, value = _texts(inside, 2)
            if said != kind:
                raise ValueError
            self._key.verify(value, _signed(digest), *options)
        except Exception:  # cryptography's InvalidSignature, or no signature at all
            return f"{signature}: does not hold: {path.name} is not what was signed"
        return ""

    def _inside(self, content: bytes) -> bytes | None:
        """Return what is signed, and how; None: by another key."""
        lines = content.decode("ascii").split()
        text = " ".join(lines)
        if not (text.startswith(_BEGIN) and text.endswith(_END)):
            raise ValueError
        blob = base64.b64decode("".join(text[len(_BEGIN) : -len(_END)].split()), validate=True)
        if not blob.startswith(_MAGIC + struct.pack(">I", 1)):
            raise ValueError
        public, namespace, reserved, hashed, inside = _texts(blob[len(_MAGIC) + 4 :], 5)
        if (namespace, reserved, hashed) != (NAMESPACE, b"", b"sha512"):
            raise ValueError
        return inside if public == self._public else None


def _key_in(path: Path, option: str) -> bytes:
    """Return the content of a key's file.

    Raises:
        UsageError: it cannot be read, or is too large for a key.
    """
    try:
        return read_bytes(path, _LARGEST)
    except UsageError as error:
        raise UsageError(f"{option} {error}") from error


def _text(content: bytes) -> bytes:
    return struct.pack(">I", len(content)) + content


def _texts(blob: bytes, count: int) -> list[bytes]:
    """Return the texts that a blob is made of, neither more nor fewer.

    Raises:
        ValueError, struct.error: it is not made of so many.
    """
    found, place = [], 0
    for _ in range(count):
        (size,) = struct.unpack_from(">I", blob, place)
        found.append(blob[place + 4 : place + 4 + size])
        place += 4 + size
    if place != len(blob):
        raise ValueError
    return found


def _signed(digest: bytes) -> bytes:
    """Return what a signature is of: the digest of a file, and what for."""
    return _MAGIC + b"".join(map(_text, (NAMESPACE, b"", b"sha512", digest)))


def _wire(key: Any, where: str) -> bytes:
    """Return a public key as OpenSSH sends it.

    Raises:
        UsageError: it is of another kind than Ed25519 and RSA.
    """
    line = key.public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH)
    kind, text = line.split()[:2]
    if kind not in (b"ssh-ed25519", b"ssh-rsa"):
        raise UsageError(f"{where}: is of kind {kind.decode()}; give an Ed25519 or an RSA key (ssh-keygen -t ed25519)")
    return base64.b64decode(text)


def _algorithm(key: Any) -> tuple[Any, ...]:
    """Return the name of how a key signs, and what cryptography has to be told of it."""
    return (b"rsa-sha2-512", PKCS1v15(), SHA512()) if isinstance(key, RSAPublicKey) else (b"ssh-ed25519",)

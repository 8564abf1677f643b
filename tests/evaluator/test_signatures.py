"""Signed results: `ssh-keygen -Y` agrees, and what is not signed by the key is said."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest
from cli_support import one_line
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec, ed25519, rsa
from skd_evaluator.campaign.store.manifest import MANIFEST, write_manifests
from skd_evaluator.campaign.store.signature import PublicKey, Signer
from skd_evaluator.campaign.store.verification import verify
from skd_sim.errors import UsageError

SIGNATURE = f"{MANIFEST}.sig"
ssh_keygen = pytest.mark.skipif(shutil.which("ssh-keygen") is None, reason="needs ssh-keygen")


def write_key(path: Path, kind: str = "ed25519") -> Path:
    made = {
        "ed25519": ed25519.Ed25519PrivateKey.generate,
        "rsa": lambda: rsa.generate_private_key(65537, 2048),
        "ecdsa": lambda: ec.generate_private_key(ec.SECP256R1()),
    }[kind]()
    secret = serialization.NoEncryption()
    path.write_bytes(made.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.OpenSSH, secret))
    path.chmod(0o600)
    path.with_suffix(".pub").write_bytes(
        made.public_key().public_bytes(serialization.Encoding.OpenSSH, serialization.PublicFormat.OpenSSH) + b" a lab\n"
    )
    return path


@pytest.fixture(scope="module", params=["ed25519", "rsa"])
def key(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_key(tmp_path_factory.mktemp("keys") / "key", request.param)


@pytest.fixture
def folder(tmp_path: Path, key: Path) -> Path:
    """What a command writes: two results below a folder, each signed."""
    for name in ("a", "b"):
        (tmp_path / "out" / name).mkdir(parents=True)
        (tmp_path / "out" / name / "assessment.json").write_text(name)
    write_manifests(tmp_path / "out", Signer(key))
    return tmp_path / "out"


def test_every_result_is_signed_and_the_whole_holds_together(folder: Path, key: Path) -> None:
    public = PublicKey(key.with_suffix(".pub"))
    for inside in (folder, folder / "a", folder / "b"):
        assert public.fault_of(inside / MANIFEST) == ""
    whole = verify(folder, public)
    assert (whole.fine, whole.remarks) == (True, ("signed by the key",))
    assert whole.files is not None
    assert f"a/{SIGNATURE}" in whole.files.same
    assert not whole.files.others


@ssh_keygen
def test_ssh_keygen_agrees(folder: Path, key: Path, tmp_path: Path) -> None:
    (tmp_path / "allowed").write_text(f"lab {key.with_suffix('.pub').read_text()}")
    check = ["ssh-keygen", "-Y", "verify", "-f", tmp_path / "allowed", "-I", "lab", "-n", "skd", "-s"]
    manifest = (folder / MANIFEST).read_bytes()
    assert subprocess.run([*check, folder / SIGNATURE], input=manifest, capture_output=True).returncode == 0
    assert subprocess.run([*check, folder / SIGNATURE], input=manifest + b" ", capture_output=True).returncode != 0
    # And what it signs is taken here.
    (folder / SIGNATURE).unlink()
    sign = ["ssh-keygen", "-Y", "sign", "-n", "skd", "-f", key, folder / MANIFEST]
    subprocess.run(sign, check=True, capture_output=True)
    assert PublicKey(key.with_suffix(".pub")).fault_of(folder / MANIFEST) == ""


@ssh_keygen
def test_what_the_key_has_signed_for_something_else_does_not_count(folder: Path, key: Path) -> None:
    (folder / SIGNATURE).unlink()
    sign = ["ssh-keygen", "-Y", "sign", "-n", "file", "-f", key, folder / MANIFEST]
    subprocess.run(sign, check=True, capture_output=True)
    assert "is no signature of a result" in PublicKey(key.with_suffix(".pub")).fault_of(folder / MANIFEST)


def test_another_key_another_manifest_and_no_signature_are_said(folder: Path, key: Path, tmp_path: Path) -> None:
    public = PublicKey(key.with_suffix(".pub"))
    other = PublicKey(write_key(tmp_path / "other").with_suffix(".pub"))
    assert other.fault_of(folder / MANIFEST).endswith("is by another key")
    (folder / "a" / "assessment.json").write_text("forged")
    write_manifests(folder)  # as somebody without the key can
    found = verify(folder, public)
    assert not found.fine
    assert "manifest.sha256 is not what was signed" in found.problems[0]
    (folder / SIGNATURE).unlink()
    assert "No such file" in verify(folder, public).problems[0]
    assert verify(folder).fine
    text = (folder / "b" / SIGNATURE).read_bytes()
    for content in (b"", b"\xff", text[:-20], text.replace(b"\n", b"", 3)[:90], text[:60] + b"AAAA" + text[64:]):
        (folder / SIGNATURE).write_bytes(content)
        assert "\n" not in (fault := public.fault_of(folder / MANIFEST))
        assert fault


def test_every_bit_of_a_signature_counts(folder: Path, key: Path) -> None:
    public, path = PublicKey(key.with_suffix(".pub")), folder / SIGNATURE
    text = bytearray(path.read_bytes())
    for place in range(40, len(text) - 40, 7):
        changed = bytearray(text)
        changed[place] = ord("A") if changed[place] != ord("A") else ord("B")
        path.write_bytes(changed)
        assert public.fault_of(folder / MANIFEST), place


def test_keys_that_cannot_sign_are_refused_before_anything_runs(skd_here, tmp_path: Path) -> None:
    (tmp_path / "nothing").write_text("nothing")
    for path, said in (
        (write_key(tmp_path / "ecdsa", "ecdsa"), "give an Ed25519 or an RSA key"),
        (tmp_path / "nothing", "is no private key"),
        (tmp_path / "gone", "No such file"),
    ):
        with pytest.raises(UsageError, match=said):
            Signer(path)
    one_line(skd_here("assess", "--sign", str(tmp_path / "nothing"), "--out", "out"), 2, "is no private key")
    with pytest.raises(UsageError, match="is no public key"):
        PublicKey(tmp_path / "nothing")


@ssh_keygen
def test_a_key_with_a_password_is_left_to_ssh_keygen(tmp_path: Path) -> None:
    make = ["ssh-keygen", "-q", "-t", "ed25519", "-N", "secret", "-f", tmp_path / "locked"]
    subprocess.run(make, check=True, capture_output=True)
    with pytest.raises(UsageError, match="ssh-keygen -Y sign -n skd"):
        Signer(tmp_path / "locked")


def test_a_probe_is_signed_and_verified(skd_here, tmp_path: Path) -> None:
    key = write_key(tmp_path / "key")
    done = skd_here("probe", "--episodes", "4", "--sign", str(key), "--out", str(tmp_path / "probe"), "--quiet")
    assert done.returncode == 0, done.stderr
    done = skd_here("verify", str(tmp_path / "probe"), "--key", str(key.with_suffix(".pub")))
    assert "signed by the key" in done.stdout
    other = write_key(tmp_path / "other").with_suffix(".pub")
    done = skd_here("verify", str(tmp_path / "probe"), "--key", str(other))
    assert done.returncode == 1
    assert "by another key" in done.stdout

"""axe-core of Deque Systems, which finds what shuts people out of a page, by WCAG 2.2: pinned, from npm."""

from __future__ import annotations

import base64
import hashlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

_VERSION = "4.10.3"
_SHA512 = "Xm7bpRXnDSX2YE2YFfBk2FnF0ep6tmG7xPh8iHee8MIcrgq762Nkce856dYtJYLkuIoYZvGfTs/PbZhideTcEg=="
"""Of the package's archive, as npm's registry states it (dist.integrity)."""
RULES = ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "wcag22aa"]
_SERIOUS = ("serious", "critical")
_LIMIT = 120.0  # s for the registry to answer


def axe_source() -> str:
    """Return the program, from the cache or from npm; the test is skipped where there is neither."""
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    kept = cache / "skd-tests" / f"axe-core-{_VERSION}.tgz"
    if not kept.exists():
        npm = shutil.which("npm")
        if npm is None:
            pytest.skip("axe-core is not here: npm is not installed")
        with tempfile.TemporaryDirectory() as folder:
            words = [npm, "pack", f"axe-core@{_VERSION}", "--silent", "--ignore-scripts"]
            try:
                done = subprocess.run(words, cwd=folder, capture_output=True, text=True, timeout=_LIMIT, check=False)
            except subprocess.TimeoutExpired:
                pytest.skip("axe-core is not here: npm's registry does not answer")
            archives = list(Path(folder).glob("*.tgz"))
            if done.returncode or not archives:
                pytest.skip(f"axe-core is not here: npm pack: {done.stderr.strip()[:200]}")
            kept.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(archives[0], kept.with_suffix(".part"))
            kept.with_suffix(".part").replace(kept)
    digest = base64.b64encode(hashlib.sha512(kept.read_bytes()).digest()).decode()
    assert digest == _SHA512, f"{kept} is not axe-core {_VERSION} as npm has it"
    with tarfile.open(kept) as archive:
        file = archive.extractfile("package/axe.min.js")
        assert file is not None
        return file.read().decode("utf-8")


def serious_findings(page: Any, source: str, rules: Sequence[str]) -> list[str]:
    """Return what axe-core finds on a page that is serious or critical: rule, place and reason.

    Args:
        page: the page.
        source: the program.
        rules: names of rules, or of sets of rules, that are looked at.
    """
    page.evaluate(source)  # beside the page's policy, which lets no other code in
    found = page.evaluate(f"axe.run(document, {{ resultTypes: ['violations'], runOnly: {list(rules)} }})")
    return [
        f"{rule['id']}: {' '.join(map(str, node['target']))}: {node['failureSummary'].splitlines()[-1].strip()}"
        for rule in found["violations"]
        if rule["impact"] in _SERIOUS
        for node in rule["nodes"]
    ]

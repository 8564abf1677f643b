"""A headless Chromium, where there is one; a page that tells what it asked for; and axe-core, which checks a page."""

import base64
import hashlib
import os
import shutil
import subprocess
import tarfile
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from common import PATIENCE

_NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
_QUIET = (
    "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip


@contextmanager
def chromium() -> Iterator[Any]:
    """Yield a headless browser; the test is skipped where no Chromium is installed."""
    executable = next(filter(None, map(shutil.which, _NAMES)), None)
    if executable is None:
        pytest.skip("Chromium is not installed (Debian: apt-get install chromium)")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=executable, args=list(_QUIET), chromium_sandbox=False)
        try:
            yield browser
        finally:
            browser.close()


@dataclass
class Opened:
    """A page, with all that it said, asked for and popped up."""

    page: Any
    said: list[str] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    popped: list[str] = field(default_factory=list)

    def text(self, selector: str) -> str:
        return str(self.page.inner_text(selector))

    def count(self, selector: str) -> int:
        return int(self.page.locator(selector).count())

    def column(self, title: str) -> list[str]:
        """The cells of a column of the table of episodes, as they are shown."""
        titles = [str(one).rstrip(" ▲▼") for one in self.page.locator("#table thead th").all_inner_texts()]
        return [
            str(one)
            for one in self.page.locator(f"#table tbody tr > :nth-child({titles.index(title) + 1})").all_inner_texts()
        ]

    def assert_quiet(self, file: Path) -> None:
        """Nothing was reported, nobody was asked for anything but the file itself, and nothing popped up."""
        assert (self.said, self.popped) == ([], [])
        assert self.asked == [file.resolve().as_uri()]


def open_page(browser: Any, file: Path, width: int = 1000, scheme: str = "light") -> Opened:
    page = browser.new_context(viewport={"width": width, "height": 900}, color_scheme=scheme).new_page()
    opened = Opened(page)
    page.on("console", lambda message: opened.said.append(message.text))
    page.on("pageerror", lambda error: opened.said.append(str(error)))
    page.on("request", lambda request: opened.asked.append(request.url))
    page.on("dialog", lambda dialog: (opened.popped.append(dialog.message), dialog.dismiss()))
    page.goto(file.resolve().as_uri())
    # The page's policy forbids what `wait_for_function` does: to make code of a text.
    page.locator("html[data-ready='yes']").wait_for(state="attached", timeout=1000.0 * PATIENCE)
    return opened


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
        return file.read().decode("utf-8")


def serious_findings(page: Any, source: str, rules: Sequence[str]) -> list[str]:
    """Return what axe-core finds on a page that is serious or critical: rule, place and reason."""
    page.evaluate(source)  # beside the page's policy, which lets no other code in
    found = page.evaluate(f"axe.run(document, {{ resultTypes: ['violations'], runOnly: {list(rules)} }})")
    return [
        f"{rule['id']}: {' '.join(map(str, node['target']))}: {node['failureSummary'].splitlines()[-1].strip()}"
        for rule in found["violations"]
        if rule["impact"] in _SERIOUS
        for node in rule["nodes"]
    ]

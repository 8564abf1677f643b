"""What tests of the report share: a headless Chromium, where there is one, and a page that tells what it asked for."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
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
    """Open a report and wait until it is drawn."""
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

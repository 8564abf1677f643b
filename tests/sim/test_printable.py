"""Text of others on the terminal."""

from __future__ import annotations

import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.inputs.files import one_line, printable


@given(st.text())
def test_nothing_that_steers_a_terminal_is_left(text):
    assert not [one for one in printable(text) if one not in "\n\t" and unicodedata.category(one) in ("Cc", "Cf", "Cs")]
    assert "\n" not in one_line(text)


@pytest.mark.parametrize("text", ["Größe φ → ψ ≤ 3\u00a0m [0.1, 0.2]\n\tζ²", "日本語", "e\u0301"])
def test_what_steers_nothing_stays(text):
    assert printable(text) == text

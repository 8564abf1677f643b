"""Text of others on the terminal."""

from __future__ import annotations

import io
import sys
import unicodedata

import pytest
from hypothesis import given
from hypothesis import strategies as st
from skd_sim.inputs.printable import PrintableStream, guarded, one_line, own, printable, printable_json


@given(st.text())
def test_nothing_that_steers_a_terminal_is_left(text):
    for found in (printable(text), printable_json(text)):
        assert not [one for one in found if one not in "\n\t" and unicodedata.category(one) in ("Cc", "Cf", "Cs")]
    assert "\n" not in one_line(text)


@pytest.mark.parametrize("text", ["Größe φ → ψ ≤ 3\u00a0m [0.1, 0.2]\n\tζ²", "日本語", "e\u0301"])
def test_what_steers_nothing_stays(text):
    assert printable(text) == text


def test_the_program_itself_may_draw():
    drawn = io.StringIO()
    stream = PrintableStream(PrintableStream(drawn))
    print("\x1b[1mname\x1b[0m", file=stream)
    print("\x1b[1mbold\x1b[0m", file=own(stream))
    assert drawn.getvalue() == "\\x1b[1mname\\x1b[0m\n\x1b[1mbold\x1b[0m\n"


def test_an_end_of_colours_alone_passes():
    """colorama, where it is installed, writes one at the program's end to the stream that was there at its start."""
    drawn = io.StringIO()
    PrintableStream(drawn).write("\x1b[0m")
    assert drawn.getvalue() == "\x1b[0m"


def test_streams_are_put_back(capsys):
    before = sys.stdout, sys.stderr
    with guarded():
        print("\x07")
        print("\u202e", file=sys.stderr)
    assert (sys.stdout, sys.stderr) == before
    assert capsys.readouterr() == ("\\x07\n", "\\u202e\n")

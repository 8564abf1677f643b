"""A signal that comes in what machine code calls is not lost, and ends nothing by SIGSEGV."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest
from common import PATIENCE
from skd_sim.program.interruption import Interrupted, Interruption

PROGRAM = """
import os, signal, sys, time
from numba.core.registry import cpu_target
from skd_sim.kernels.compilation import kernel
from skd_sim.program.interruption import Interrupted, Interruption

@kernel
def doubled(x):
    return 2.0 * x

engine = cpu_target.target_context.codegen()._engine._ee
hook = f"_object_cache_{sys.argv[1]}"
original = getattr(engine, hook)
sent = []

def interrupted(*arguments):
    if not sent:
        sent.append(int(sys.argv[2]))
        os.kill(os.getpid(), sent[0])
    return original(*arguments)

if sys.argv[3] == "signal":
    setattr(engine, hook, interrupted)
with Interruption() as interruption:
    try:
        found = doubled(3.0)
        time.sleep(10.0 if sent else 0.0)
        print("not interrupted", found)
    except Interrupted:
        print("interrupted")
"""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
@pytest.mark.parametrize("asked", ["getbuffer", "notify"])
def test_a_signal_while_llvm_asks_for_code(tmp_path: Path, asked: str, number: int) -> None:
    """Code that is read from the cache is what LLVM gets no other way."""
    (tmp_path / "program.py").write_text(PROGRAM)

    def run(with_signal: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            [sys.executable, tmp_path / "program.py", asked, str(int(number)), with_signal],
            env={**os.environ, "SKD_CACHE_DIR": str(tmp_path / "kernels")},
            capture_output=True,
            text=True,
            timeout=PATIENCE,
        )

    if asked == "getbuffer":  # of what was compiled before
        assert run("").stdout == "not interrupted 6.0\n"
    done = run("signal")
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


UNBOXING = """
import ctypes, os, signal, sys, time
import numpy as np
from skd_sim.kernels.compilation import kernel
from skd_sim.program.interruption import Interrupted, Interruption

@kernel
def drawn(rng):
    return rng.random()

rng = np.random.default_rng(1)
drawn(rng)
vars(ctypes)["to_send"] = [int(sys.argv[1])]
exec("import os\\ndef cast(obj, typ):\\n    if to_send: os.kill(os.getpid(), to_send.pop())\\n    return _cast(obj, obj, typ)", vars(ctypes))
with Interruption() as interruption:
    try:
        drawn(rng)
        time.sleep(10.0)
        print("not interrupted")
    except Interrupted:
        print("interrupted")
"""  # noqa: E501


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_while_a_kernel_takes_its_generator(number: int) -> None:
    done = subprocess.run(
        [sys.executable, "-c", UNBOXING, str(int(number))], capture_output=True, text=True, timeout=PATIENCE
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


LOST = """
import os, signal, time
from skd_sim.program.interruption import Interrupted, Interruption

class Dies:
    def __del__(self):
        os.kill(os.getpid(), signal.SIGINT)
        for _ in range(100): pass  # here it comes

with Interruption():
    try:
        Dies()
        time.sleep(10.0)
        print("not interrupted")
    except Interrupted:
        print("interrupted")
"""


def test_a_signal_that_is_lost_is_sent_again() -> None:
    """As one is that comes, or comes again, in a callback of machine code that nobody has listed."""
    done = subprocess.run([sys.executable, "-c", LOST], capture_output=True, text=True, timeout=PATIENCE)
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


def test_a_signal_in_the_moment_in_which_it_begins_to_be_ignored_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Python calls the hook for what nobody can catch, with an error of its own, where it finds no handler any more."""
    said: list[object] = []
    monkeypatch.setattr(sys, "unraisablehook", said.append)
    at_the_end = SimpleNamespace(exc_value=OSError("Signal 2 ignored due to race condition"))
    other = SimpleNamespace(exc_value=OSError("no space left on device"))
    with Interruption() as interruption:
        sys.unraisablehook(at_the_end)  # type: ignore[arg-type]
        interruption.held = True
        sys.unraisablehook(at_the_end)  # type: ignore[arg-type]
        sys.unraisablehook(other)  # type: ignore[arg-type]
    assert said == [at_the_end, other]


def test_a_second_signal_does_not_break_off_what_the_first_one_cleans_up() -> None:
    """Who presses Ctrl-C twice left temporary folders, and a traceback of a pool that was closed twice."""
    cleaned = False
    with Interruption(cleaning=0.1) as interruption:
        with pytest.raises(Interrupted):
            signal.raise_signal(signal.SIGINT)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.raise_signal(number)
        cleaned = True
        time.sleep(0.1)
        with pytest.raises(Interrupted):  # what hangs can be ended all the same
            signal.raise_signal(signal.SIGINT)
    assert cleaned
    assert interruption.came

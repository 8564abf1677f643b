"""A signal that comes in what machine code calls is not lost, and ends nothing by SIGSEGV."""

import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from common import run_program
from skd_sim.interruption import Interrupted, Interruption

PROGRAM = """
import os, signal, sys, time
from numba.core.registry import cpu_target
from skd_sim.kernels.compilation import kernel
from skd_sim.interruption import Interrupted, Interruption

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


@pytest.mark.parametrize(("asked", "number"), [("getbuffer", signal.SIGTERM), ("notify", signal.SIGINT)])
def test_a_signal_while_llvm_asks_for_code(tmp_path: Path, asked: str, number: int) -> None:
    """Code that is read from the cache is what LLVM gets no other way."""
    (tmp_path / "program.py").write_text(PROGRAM)

    def run(with_signal: str) -> subprocess.CompletedProcess[str]:
        words = (sys.executable, tmp_path / "program.py", asked, int(number), with_signal)
        return run_program(*words, SKD_CACHE_DIR=str(tmp_path / "kernels"))

    if asked == "getbuffer":  # of what was compiled before
        assert run("").stdout == "not interrupted 6.0\n"
    done = run("signal")
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\n", "")


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

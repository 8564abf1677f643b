"""Every command of the documentation: run in small, or else at least parsed, with the reason why it is not run.

Blocks are run by bash in a folder that looks like the top of a checkout, in which every program is one that writes down
how it was called and does nothing: so loops, quotes and variables are the shell's own business. A command that is
neither run nor parsed fails. Of commands that differ by their sizes alone the first is run, and its result serves the
others; those whose output the documentation shows are run as they stand, and have to say what is shown.
"""

import argparse
import os
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
from citr_lookalike import LookAlike, Walk
from common import PATIENCE, run_skd
from markdown_it import MarkdownIt
from packaging_support import check_command
from shortened import RUNS, price

ROOT = Path(__file__).resolve().parents[2]
SHELLS = {"bash", "console", "sh", "shell"}
FOREIGN = (
    *("colcon", "cyclonedx-py", "dask", "docker", "git", "pip-audit", "python", "python3"),
    *("ros2", "rosdep", "ssh-keygen", "sudo"),
)
"""Programs that the documentation calls and that do not lie in the checkout."""
_INTERPRETERS = (
    *(".venv/bin/python", ".venv-jazzy/bin/python", ".venv/bin/pip"),
    *(".venv-commonroad/bin/python", ".venv-commonroad/bin/skd"),
)
_READ = ("ros_ws/install/setup.bash", ".venv-jazzy/bin/activate", "manifest.sha256")
_RECORDER = """#!/bin/sh
{ printf 'PYTHONPATH=%s\\0' "$PYTHONPATH"; pwd | tr '\\n' '\\0'; printf '%s\\0' "$0" "$@"; printf '\\036'; } >>"$CALLS"
[ "${0##*/} $1" != "git clone" ] || ln -sfn . "$3"
"""


@dataclass(frozen=True)
class Block:
    document: str
    line: int
    language: str | None  # what stands behind the fence; empty where nothing does; None for an indented block
    text: str

    @property
    def is_shell(self) -> bool:
        """Whether it holds commands: what is indented does."""
        return self.language is None or self.language in SHELLS

    def __str__(self) -> str:
        return f"{self.document}:{self.line}"


@dataclass(frozen=True)
class Call:
    block: Block
    program: str  # a path from the top of the checkout, or a name
    words: tuple[str, ...]
    python_path: str
    folder: str  # where it is run, from the top of the checkout

    def __str__(self) -> str:
        return " ".join((self.program, *self.words))


def documents() -> list[Path]:
    """Every document that a reader may take commands from."""
    first = [ROOT / name for name in ("README.md", "CONTRIBUTING.md", "requirements/README.md")]
    return [*first, *sorted((ROOT / "docs").rglob("*.md")), *sorted((ROOT / "examples").rglob("README.md"))]


def blocks(document: Path) -> Iterator[Block]:
    name = str(document.relative_to(ROOT))
    for token in MarkdownIt().parse(document.read_text(encoding="utf-8")):
        if token.type in ("fence", "code_block"):
            line = (token.map or [0])[0] + 1
            yield Block(name, line, token.info.strip() if token.type == "fence" else None, token.content)


def make_checkout(folder: Path) -> Path:
    """Return a folder of programs that do nothing: those that the documentation calls by their names."""
    found = folder / "programs"
    scripts = [path for path in (ROOT / "scripts").iterdir() if os.access(path, os.X_OK)]
    programs = [*(found / name for name in FOREIGN), *(folder / "scripts" / path.name for path in scripts)]
    for program in (*programs, *(folder / name for name in _INTERPRETERS)):
        program.parent.mkdir(parents=True, exist_ok=True)
        program.write_text(_RECORDER)
        program.chmod(0o755)
    (folder / "skd_results" / "first").mkdir(parents=True)
    for name in _READ:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()
    return found


def calls(shell: Sequence[Block], folder: Path) -> dict[Block, list[Call]]:
    found = make_checkout(folder)
    log = folder / "calls"
    environment = {"PATH": f"{found}:/usr/bin:/bin", "CALLS": str(log), "HOME": str(folder)}
    said: dict[Block, list[Call]] = {}
    for block in shell:
        log.write_bytes(b"")
        command = ["bash", "-eu", "-o", "pipefail", "-c", block.text]
        how = {"capture_output": True, "text": True, "timeout": PATIENCE}
        done = subprocess.run(command, cwd=folder, env=environment, check=False, **how)
        assert (done.returncode, done.stderr) == (0, ""), f"{block}: {done.stderr}"
        said[block] = []
        for entry in log.read_text(encoding="utf-8").split("\036")[:-1]:
            path, place, program, *words = entry.split("\0")[:-1]
            name = Path(place, program).resolve()
            within = name.relative_to(folder) if name.is_relative_to(folder) else name
            known, there = within.parts[0] == "programs", os.path.relpath(Path(place).resolve(), folder)
            called = within.name if known else str(within)
            said[block].append(Call(block, called, tuple(words), path.removeprefix("PYTHONPATH="), there))
    return said


NOT_RUN = {  # of a command as it stands: why it is not run here
    r"git clone|sudo apt|.* -m pip |pip-audit|cyclonedx-py|colcon|docker": "changes the machine, or needs the network",
    r"ros2": "needs a sourced ROS 2: tests/packaging/test_files.py has it where there is one",
    r".* --graph": "four processes: tests/graph/test_vendor_controller.py runs those that need no stack of others",
    r"scripts/(run-node|assess-controller|replay-logs)": "the same",
    r"scripts/skd (replay skd_results/(node|monitor)|fit skd_results/probe)": "of a graph's recordings: the same",
    r"scripts/skd assess --controller careful": "tests/evaluator/test_users_package.py runs it",
    r"scripts/skd import drive": "needs a drive: tests/exchange/test_import.py writes such a bag",
    r"scripts/test tests/exchange": "these tests themselves",
    r"scripts/exchange-readers": "needs the network, and takes 1 GB",
    r"scripts/skd .* roundabout_exit": "a package's: tests/examples/test_roundabout.py has it beside SKD",
    r"scripts/skd compare .*--explain": "a search in vain: tests/evaluator/test_distinguishing_trial.py has one",
    r"scripts/skd fuse --calibrate": "a minute: tests/evaluator/test_fusion_trials.py has a smaller one",
    r"scripts/skd fit --people": "half a minute: tests/evaluator/test_behaviour_fit.py has a smaller one",
    r"scripts/skd .*--simulator metadrive": "needs the extra metadrive: tests/sim/test_metadrive.py has smaller ones",
    r"(.* -m )?dask |.* --scheduler": "a cluster: tests/evaluator/test_dask_cluster.py has one",
    r"scripts/skd scenarios check": "tests/evaluator/test_scenarios_command.py checks files of one's own",
    r"scripts/skd (campaign|benchmark)": "test_campaign_command.py and test_benchmark.py in tests/evaluator have some",
    r".*python benchmarks/": "minutes to hours: a figure of the documentation each",
    r".* sumo_drivers:Krauss --adversary-model": "examples/sumo/README.md has it in fewer words",
    r".*\.venv-commonroad": "an environment of its own: tests/examples/test_commonroad_planner.py runs there",
}
_POLICY = ROOT / "docs" / "python_policy.md"
COUNTS = "--safe-count 2 --kamikaze-count 2 --collision-runs 2 --simulations 20"
SMALLER = {  # what is put behind a command, so that it takes a second
    "assess": f"{COUNTS} --workers 1",
    "sweep": f"{COUNTS} --workers 1 --multipliers 0.5 1.5",
    "protocol": "--workers 1 --margin-limit 0",
    "probe": "--episodes 30 --workers 1",
}
QUICKER = {"drive": "-p rate_factor:=100"}  # of a command that writes no result
MARGIN = ["--margin-limit", "2"]
NO_RISK = ["--behaviour", "none"]  # thousands of crossings, which of a user's car are driven one by one
ENOUGH = {"--until-width": "--until-width 9"}  # where an option is there, what makes it end soon
SIZES = {"--seed", "--multiplier", "--safe-count", "--kamikaze-count", "--collision-runs", "--simulations"}
SHOWN = {"assess": "--workers 1"}  # what the output does not depend on
REGISTERED = {"near": "paper", "ice": "world"}  # by the package of docs/extending.md → of SKD's own
EARLIER = ("A", "B", "C", "earlier_result", "result_of_A", "result_of_B", "versions", "skd_results/first")  # results

BLOCKS = [block for document in documents() for block in blocks(document)]
SHELL = [block for block in BLOCKS if block.is_shell]
DOCUMENTS = sorted({block.document for block in SHELL})


@pytest.fixture(scope="module")
def called(tmp_path_factory: pytest.TempPathFactory) -> dict[Block, list[Call]]:
    return calls(SHELL, tmp_path_factory.mktemp("recorded").resolve())


@pytest.fixture(scope="module")
def checkout(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that looks like the top of the checkout, with what a reader has who comes to the commands."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("benchmarks", "examples", "ros_ws"):
        (folder / name).symlink_to(ROOT / name)
    recorded = folder / "path" / "to" / "citr_vci_lat_uni"
    recorded.mkdir(parents=True)
    LookAlike(walks=[Walk(speed=speed) for speed in (1.2, 1.4, 1.6, 1.8)]).write(recorded)
    for document in documents():  # what a document says that a file holds
        text = document.read_text(encoding="utf-8")
        for name, code in re.findall(r"<!-- file: (\S+) -->\n+```python\n(.*?)```", text, re.DOTALL):
            (folder / name).write_text(code, encoding="utf-8")
    (controller,) = re.findall(r"```python\n(class MyController.*?)```", _POLICY.read_text("utf-8"), re.S)
    (folder / "my_module.py").write_text(controller, encoding="utf-8")
    first = folder / EARLIER[-1]
    assert run_skd("assess", *shlex.split(SMALLER["assess"]), *MARGIN, "--out", first) == 0
    for name in EARLIER[:-1]:
        shutil.copytree(first, folder / name)
    return folder


@pytest.fixture(scope="module")
def results(checkout: Path) -> dict[str, Path]:
    """Folders of what has been run, by the command without its sizes."""
    return {"scripts/skd assess": checkout / EARLIER[-1]}


def reason(call: Call) -> str | None:
    return next((why for pattern, why in NOT_RUN.items() if re.match(pattern, str(call))), None)


def shown_output(block: Block) -> str:
    """What the document shows right below a block of commands."""
    here = [one for one in BLOCKS if one.document == block.document]
    below = here[here.index(block) + 1 :][:1]
    lines = (ROOT / block.document).read_text(encoding="utf-8").splitlines()
    for after in below:
        end = block.line - 1 + len(block.text.splitlines()) + (2 if block.language else 0)
        between = [line for line in lines[end : after.line - 1] if line.strip()]
        if after.language == "text" and len(between) <= 1:
            return after.text
    return ""


def without_sizes(call: Call) -> str:
    """A command but for its numbers and for where its result goes."""
    words = list(call.words)
    for option in {*SIZES, "--out"} & set(words):
        del words[words.index(option) : words.index(option) + 2]
    return " ".join((call.program, *words, *call.python_path.split()))


def run(call: Call, checkout: Path, results: dict[str, Path], as_it_stands: bool) -> None:
    """Run a command in the checkout, or take the result of one like it."""
    out, key = Path(call.words[call.words.index("--out") + 1]) if "--out" in call.words else None, without_sizes(call)
    if not as_it_stands and key in results:
        if out is not None and not (checkout / out).exists():
            shutil.copytree(results[key], checkout / out)
        return
    command = call.words[0]
    words = list(call.words)
    words += shlex.split((SHOWN if as_it_stands else SMALLER | QUICKER).get(command, ""))
    if command == "assess" and not as_it_stands:
        words += MARGIN if "--margin-limit 0" not in shlex.join(words) else []
        if "--controller" in words:
            words = ["generic" if word == "learned" else word for word in words]  # learning takes a minute
            words += [] if "--behaviour" in words else NO_RISK
    for option in ENOUGH.keys() & set(call.words):
        words += shlex.split(ENOUGH[option])
    if out is None and command in SMALLER:
        unnamed = len(list((checkout / "skd_results").glob("unnamed_*")))
        words += ["--out", f"skd_results/unnamed_{unnamed}"]
    assert run_skd(*words) == 0, f"{call.block}: {shlex.join(words)}"
    if "--out" in words:
        made = checkout / words[words.index("--out") + 1]
        assert made.exists()
        if made.is_dir():
            results.setdefault(key, made)


def run_python(call: Call, checkout: Path, patch: pytest.MonkeyPatch) -> None:
    """Run a program in this process, or a module in one of its own."""
    if call.words[0] == "-m":
        subprocess.run([sys.executable, *call.words], cwd=checkout / call.folder, check=True)
        return
    patch.chdir(checkout / call.folder)
    patch.setattr(sys, "argv", [*call.words])
    folder = str(Path(call.words[0]).parent.resolve())
    patch.syspath_prepend(folder)
    runpy.run_path(call.words[0], run_name="__main__")
    for name, module in [*sys.modules.items()]:
        if str(getattr(module, "__file__", "")).startswith(folder):
            del sys.modules[name]  # whose name may be another's, too


def parse(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let whoever would be run read its options, and no more."""
    words = [call.program, *(REGISTERED.get(word, word) for word in call.words)]
    if re.fullmatch(r"benchmarks/\w+\.py", call.words[0] if call.words else ""):

        class ParsedError(Exception):
            pass

        known = argparse.ArgumentParser.parse_known_args

        def parse_args(parser: argparse.ArgumentParser, *given: object) -> None:
            assert known(parser)[1] == []
            raise ParsedError

        def parse_known_args(parser: argparse.ArgumentParser, *given: object) -> None:
            further = known(parser)[1]  # are options of an assessment
            monkeypatch.undo()
            check_command(shlex.join(["scripts/skd", "assess", *further]))
            raise ParsedError

        monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_args)
        monkeypatch.setattr(argparse.ArgumentParser, "parse_known_args", parse_known_args)
        monkeypatch.setattr(sys, "argv", [*call.words])
        monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
        with pytest.raises(ParsedError):
            runpy.run_path(str(ROOT / call.words[0]), run_name="__main__")
    else:
        check_command(shlex.join(words))


@pytest.mark.parametrize("document", DOCUMENTS)
def test_commands(document, called, checkout, results, monkeypatch, capfd):
    monkeypatch.chdir(checkout)
    monkeypatch.setenv("COLUMNS", "120")  # as in the documentation, and wherever the test is run
    for block in [one for one in SHELL if one.document == document]:
        is_run = any(reason(call) is None for call in called[block])
        shown = shown_output(block) if is_run else ""
        capfd.readouterr()
        for call in called[block]:
            with monkeypatch.context() as patch:
                if reason(call) is not None:
                    parse(call, patch)
                elif call.program.endswith("scripts/skd") and call.words != ("--version",):
                    parse(call, patch)
                    for path in filter(None, call.python_path.split(":")):
                        patch.syspath_prepend(str(checkout / path))
                        patch.setenv("PYTHONPATH", str(checkout / path))
                    if shown:
                        patch.setattr(price, "RUNS", RUNS["RUNS"])
                    run(call, checkout, results, bool(shown))
                elif call.program in ("python", ".venv/bin/python"):
                    run_python(call, checkout, patch)
                elif call.program == "scripts/skd":
                    subprocess.run([ROOT / call.program, *call.words], cwd=checkout / call.folder, check=True)
                else:
                    pytest.fail(f"{block}: neither run nor in the table of what is not: {call}")
        assert_shown(shown, capfd.readouterr().out, block)


def assert_shown(shown: str, said: str, block: Block) -> None:
    """Each line that a document shows was said, in this order; the time that a command takes may differ."""
    rest = iter(map(plain, said.splitlines()))
    for line in map(plain, shown.splitlines()):
        assert not line or line in rest, f"{block}: nobody says {line!r}\n{said}"


def plain(line: str) -> str:
    return " ".join(re.sub(r"^[\d.]+ (s|min);", "some time;", line).split())


def test_no_rule_is_left_over(called: dict[Block, list[Call]]):
    everything = [call for found in called.values() for call in found]
    assert len(everything) > 90
    assert [one for one in NOT_RUN if not any(re.match(one, str(call)) for call in everything)] == []


def test_every_block_says_what_it_is():
    assert [str(block) for block in BLOCKS if block.language == ""] == []


def test_a_command_that_nobody_knows_is_noticed(tmp_path: Path):
    for number, text in enumerate(("scripts/skid assess", "scripts/skd 'assess", "make all")):
        with pytest.raises(AssertionError):
            calls([Block("a.md", 1, "bash", text)], tmp_path / str(number))
    block = Block("a.md", 1, None, "for c in 0.5 1; do PYTHONPATH=here scripts/skd assess --multiplier $c; done")
    (found,) = calls([block], tmp_path).values()
    assert [(str(call), call.python_path) for call in found] == [
        ("scripts/skd assess --multiplier 0.5", "here"),
        ("scripts/skd assess --multiplier 1", "here"),
    ]
    with pytest.raises(SystemExit):
        parse(Call(block, "scripts/skd", ("assess", "--multiplyer", "1"), "", "."), pytest.MonkeyPatch())

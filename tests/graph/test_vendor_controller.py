"""The commands of docs/ros2_stack.md and docs/logs.md, as they stand there, with the page's node and the example."""

import json
import math
import os
import re
import shlex
import shutil
import signal
import sys
import uuid
from pathlib import Path

import pytest
from common import new_domain
from graph_support import Program, assert_all_gone, in_domain, skd_here

ROOT = Path(__file__).resolve().parents[2]
PAGES = (ROOT / "docs" / "ros2_stack.md", ROOT / "docs" / "logs.md")
pytestmark = pytest.mark.skipif(shutil.which("bash") is None, reason="needs bash")


def marked(mark: str) -> list[list[str]]:
    """Return the lines of each code block of the pages that follows a mark."""
    text = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    blocks = re.findall(rf"<!-- {mark} -->\n```bash\n(.*?)```", text, re.DOTALL)
    return [block.strip().splitlines() for block in blocks]


@pytest.fixture
def checkout(tmp_path: Path) -> Path:
    """A folder that looks like the top of the checkout, with the node of the page, where results can be left."""
    for name in ("scripts", "examples"):
        (tmp_path / name).symlink_to(ROOT / name)
    (node,) = re.findall(r"<!-- file: my_node.py -->\n+```python\n(.*?)```", PAGES[0].read_text("utf-8"), re.DOTALL)
    (tmp_path / "my_node.py").write_text(node, encoding="utf-8")
    return tmp_path


def start(line: str, checkout: Path, **environment: str) -> Program:
    """Start a command of the pages in the environment that the tests run in."""
    chosen = {"SKD_ENV": str(Path(sys.executable).parent), **environment}
    return Program(["bash", "-c", f"cd {shlex.quote(str(checkout))} && exec {line}"], chosen)


def test_marked_commands(checkout, monkeypatch, capsys):
    """All but the one in real time, which has a margin, too, in this process; none learns the car."""
    first, *lines = [line for block in marked("run") for line in block]
    assert len(lines) == 2
    small = ("--adversary-model", "generic", "--behaviour", "none", "--objective", "deviation")
    program, *words = shlex.split(first)
    assert program == "scripts/skd"
    monkeypatch.chdir(checkout)
    monkeypatch.setenv("PATH", str(Path(sys.executable).parent), prepend=os.pathsep)
    with in_domain(new_domain(), token := uuid.uuid4().hex):
        finished = skd_here(capsys, *words, *small, "--margin-limit", 0)
    assert_all_gone(token)
    assert finished.code == 0, finished.err
    for line in lines:
        if "real_time" in line:
            shorter = line.replace("--safe-count", f"{shlex.join(small)} --no-pictures --margin-limit 32 --safe-count")
            shorter = re.sub(
                "--safe-count .* --out", "--safe-count 1 --kamikaze-count 1 --collision-runs 1 --out", shorter
            )
            # Other tests keep all cores busy: a node may be late by 0.1 s, which is less than a period at this rate.
            shorter = shorter.replace("rate_factor:=20", "rate_factor:=2")
            finished = start(shorter, checkout).finish()
        else:
            finished = skd_here(capsys, *shlex.split(line)[1:])
        assert finished.code == 0, f"{line}\n{finished.out}\n{finished.err}"

    results = {
        path.parent.name: json.loads(path.read_text()) for path in checkout.glob("skd_results/*/assessment.json")
    }
    assert set(results) == {"node", "real_time", "replayed"}
    for name, result in results.items():
        assert result["controller"] == "external"
        assert math.isfinite(result["skd"]), name
        assert result["aborted"] == 0, name
    hits = [one["trials"] - one["failed"] for one in results["node"]["per_safe_trajectory"]]
    assert hits == [5, 5]
    assert results["real_time"]["margin"] is not None
    assert not results["real_time"]["margin_converged"]
    left = {
        key: results["replayed"][key] for key in ("skd", "skd_ci95_pairs", "skd_prefix", "variance", "contact_rate")
    }
    assert left == {key: results["node"][key] for key in left}


def test_an_episode_in_four_terminals(checkout):
    (lines,) = marked("terminals")
    assert [shlex.split(line)[1] for line in lines] == ["vehicle_simulator", "adversary", "car_controller", "evaluator"]
    domain = str(new_domain())
    programs = [start(line, checkout, ROS_DOMAIN_ID=domain) for line in lines]
    try:
        finished = programs[-1].finish()
    finally:
        for program in programs[:-1]:
            program.popen.send_signal(signal.SIGINT)
        codes = [program.finish().code for program in programs[:-1]]
    assert finished.code == 0, finished.err
    assert codes == [0, 0, 0]
    episode = json.loads((checkout / "skd_results" / "episode" / "episode.json").read_text())
    assert episode["outcome"] == "collision"
    assert list((checkout / "skd_results" / "episode" / "bags").rglob("*.mcap"))

"""The layout's rules: imports run one way, only nodes know ROS, no data set is kept."""

import ast
import graphlib
import re
import shutil
import subprocess
from functools import cache
from pathlib import Path

import pytest
from common import imported

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")  # each may import those before it
ROS = ("rclpy", "launch", "launch_ros", "rosbag2_py")
ROS_FOLDERS = ("ros",)
ORDERS = {  # from above to below: a folder imports from those behind it alone
    "skd_sim": "ros simulators controllers world options kernels inputs",
    "skd_adversary": "ros safe_trajectories crossing car_models pomdp",
    "skd_evaluator": ("extensions cli ros driving assessment.stages risk margin report bags assessment metrics"),
    "skd_evaluator.assessment": "stages compare files run",
    "skd_evaluator.margin": "search exact",
}


def package_modules(package: str) -> list[Path]:
    return sorted((ROOT / "ros_ws" / "src" / package / package).rglob("*.py"))


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_run_one_way(package):
    assert package_modules(package)
    above = set(PACKAGES[PACKAGES.index(package) + 1 :])
    wrong = {str(module): names for module in package_modules(package) if (names := above & imported(module))}
    assert wrong == {}


def dotted(module: Path) -> str:
    parts = module.relative_to(ROOT / "ros_ws" / "src").with_suffix("").parts[1:]
    return ".".join(parts).removesuffix(".__init__")


@cache
def arrows() -> dict[str, set[str]]:
    """Return the modules that each module of the packages imports, wherever in it."""
    files = {dotted(module): module for package in PACKAGES for module in package_modules(package)}
    found: dict[str, set[str]] = {}
    for name, module in files.items():
        named: set[str] = set()
        for node in ast.walk(ast.parse(module.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                named |= {one.name for one in node.names}
            elif isinstance(node, ast.ImportFrom) and node.module:
                inside = {f"{node.module}.{one.name}" for one in node.names}
                named |= inside if inside <= set(files) else {node.module, *inside}  # a package's own names, or modules
        found[name] = (named & set(files)) - {name}
    return found


def test_no_imports_run_in_a_circle():
    sorter = graphlib.TopologicalSorter(arrows())
    sorter.prepare()  # raises a CycleError that names one


@pytest.mark.parametrize("package", ORDERS)
def test_folders_stand_in_order(package):
    folders = ORDERS[package].split()
    source = ROOT / "ros_ws" / "src" / package.split(".")[0]
    assert all((source / f"{package}.{one}".replace(".", "/")).is_dir() for one in folders)

    def place(module: str) -> int | None:
        inside = [one for one in folders if module.startswith(f"{package}.{one}.")]
        return folders.index(max(inside, key=len)) if inside else None

    wrong = [
        (one, other)
        for one, others in arrows().items()
        for other in others
        if (above := place(one)) is not None and (below := place(other)) is not None and below < above
    ]
    assert wrong == []


@pytest.mark.parametrize("package", PACKAGES)
def test_only_nodes_know_ros(package):
    for module in package_modules(package):
        if set(module.relative_to(ROOT).parts) & set(ROS_FOLDERS):
            continue
        ros = {name for name in imported(module) if name in ROS or name.endswith(("_msgs", "_interfaces"))}
        assert not ros, f"{module} imports {ros}"


def test_no_data_set_is_in_the_repository():
    git = shutil.which("git")
    if git is None or not (ROOT / ".git").exists():
        pytest.skip("not a git checkout")
    listing = subprocess.run([git, "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listing.returncode != 0:
        pytest.skip("git does not read this checkout")
    files = listing.stdout.splitlines()
    assert "pyproject.toml" in files
    assert [name for name in files if "vci_lat" in name.lower() or name.endswith(("_filtered.csv", ".mcap"))] == []
    assert [name for name in files if name.endswith(".csv") and (ROOT / name).stat().st_size > 10_000] == []


GONE = re.compile(r"deform|closeness|attempt|encounter|\bstruck\b|foretold|foresight|hit_rate|knowledge", re.IGNORECASE)
"""Words for what is called deviation, optimality gap, trial, scenario, collision partner, nominal collision rate."""


@pytest.mark.parametrize("folder", ["ros_ws/src", "docs", "examples"])
def test_words_that_are_gone_stay_away(folder):
    texts = [one for one in (ROOT / folder).rglob("*") if one.suffix in {".py", ".md", ".msg", ".js", ".j2", ".yaml"}]
    assert [f"{path.relative_to(ROOT)}: {word[0]}" for path in texts if (word := GONE.search(path.read_text()))] == []

"""The layout's rules: imports run one way, only nodes know ROS, no data set is kept."""

from __future__ import annotations

import ast
import graphlib
import shutil
import subprocess
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("skd_sim", "skd_adversary", "skd_evaluator")  # each may import those before it
ROS = ("rclpy", "launch", "launch_ros", "rosbag2_py")
ROS_FOLDERS = ("nodes", "messages", "ros")
ROOMS = {  # of the evaluator: which others each may import
    "measure": set(),
    "campaign": {"measure"},
    "margin": {"measure", "campaign"},
    "bags": {"measure", "campaign"},
    "report": {"measure", "campaign", "ncap"},
    "fusion": {"measure", "campaign", "bags"},
    "ncap": {"measure", "campaign", "margin"},
    "exchange": {"measure", "campaign", "bags", "fusion", "report"},
    "learning": {"campaign", "bags", "measure"},
    "risk": {"campaign", "bags", "margin", "measure"},
    "assessing": {"measure", "campaign", "margin", "report", "learning", "risk"},
    "driving": {"campaign", "measure"},
    "ros": {"campaign", "bags", "learning", "assessing", "driving"},
    "campaigns": {"measure", "campaign", "margin", "ros", "assessing", "risk"},
}
ORDERS = {  # from above to below: a room imports from those behind it alone
    "skd_sim": (
        "nodes messages lockstep simulation apart controllers hazard sensors episode dynamics "
        "encounter choices geometry kernels inputs program"
    ),
    "skd_adversary": "nodes model planning",
    "skd_evaluator/campaign": "compare store judge run plan",
    "skd_evaluator/margin": "search exact ways",
    "skd_evaluator/exchange": "coming_in going_out",
    "skd_evaluator/ros": "readiness programs",
    "skd_evaluator/report": "html",
    "skd_evaluator/measure": "distances surrogate statistics",
}


def package_modules(package: str) -> list[Path]:
    return sorted((ROOT / "ros_ws" / "src" / package / package).rglob("*.py"))


@cache
def nodes_of(module: Path) -> tuple[ast.AST, ...]:
    return tuple(ast.walk(ast.parse(module.read_text(encoding="utf-8"))))


def imported(module: Path) -> Iterator[str]:
    """Yield the top-level packages that a module imports, wherever in it."""
    for node in nodes_of(module):
        if isinstance(node, ast.Import):
            yield from (name.name.split(".")[0] for name in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            yield node.module.split(".")[0]


@pytest.mark.parametrize("package", PACKAGES)
def test_imports_run_one_way(package):
    assert package_modules(package)
    above = set(PACKAGES[PACKAGES.index(package) + 1 :])
    wrong = {str(module): names for module in package_modules(package) if (names := above & set(imported(module)))}
    assert wrong == {}


@pytest.mark.parametrize("room", ROOMS)
def test_rooms_of_the_evaluator_stand_in_order(room):
    folder = ROOT / "ros_ws" / "src" / "skd_evaluator" / "skd_evaluator"
    inside = {path.name for path in folder.iterdir() if path.is_dir() and path.name != "__pycache__"}
    assert inside <= {*ROOMS, "cli"}
    modules = sorted((folder / room).rglob("*.py"))
    assert modules
    for module in modules:
        found = {
            parts[1]
            for node in nodes_of(module)
            if isinstance(node, ast.ImportFrom) and (parts := (node.module or "").split("."))[0] == "skd_evaluator"
            if len(parts) > 1
        }
        assert found & inside <= ROOMS[room] | {room}, module


def dotted(module: Path) -> str:
    """Return the name by which a module is imported."""
    parts = module.relative_to(ROOT / "ros_ws" / "src").with_suffix("").parts[1:]
    return ".".join(parts).removesuffix(".__init__")


def arrows() -> dict[str, set[str]]:
    """Return the modules that each module of the packages imports, wherever in it."""
    files = {dotted(module): module for package in PACKAGES for module in package_modules(package)}
    found: dict[str, set[str]] = {}
    for name, module in files.items():
        named: set[str] = set()
        for node in nodes_of(module):
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


@pytest.mark.parametrize("house", ORDERS)
def test_rooms_stand_in_order(house):
    prefix = ".".join(dict.fromkeys((house.split("/")[0], *house.split("/"))))
    order = {name: place for place, name in enumerate(ORDERS[house].split())}
    rooms = [*ROOT.glob(f"ros_ws/src/{house.split('/')[0]}/{house.split('/')[0]}/{'/'.join(house.split('/')[1:])}")]
    inside = {folder.name for room in rooms for folder in room.iterdir() if (folder / "__init__.py").exists()}
    assert set(order) & inside

    def room_of(module: str) -> int | None:
        return order.get(module.removeprefix(f"{prefix}.").split(".")[0]) if module.startswith(f"{prefix}.") else None

    wrong = [
        (one, other)
        for one, others in arrows().items()
        for other in others
        if (above := room_of(one)) is not None and (below := room_of(other)) is not None and below < above
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

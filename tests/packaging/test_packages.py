"""package.xml, setup.cfg and the parameter files say what the code says."""

import re
import sys
import tomllib

import pytest
from common import imported
from packaging_support import ALL_NODES, PYTHON_PACKAGES, ROOT, SOURCE, defaults_on_file, settings, setup_section
from skd_evaluator.assessment.options import CampaignOptions, EvaluatorOptions
from skd_sim.options.options import SimulatorOptions, options_of
from skd_sim.ros.support import descriptor_of

PACKAGES = ("skd_msgs", *PYTHON_PACKAGES)
ROSDEP = {name: f"python3-{name}" for name in ("jinja2", "jsonschema", "matplotlib", "numba", "numpy", "pydantic")}
ROSDEP |= {name: f"python3-{name}" for name in ("pytest", "rich", "scipy", "sklearn", "yaml")}
ROSDEP |= {"llvmlite": "python3-numba", "pydantic_core": "python3-pydantic"}  # which are made of them
ROSDEP |= {"mcap": "mcap-ros2-support", "rosbags": "python3-rosbags-pip", "zstandard": "python3-rosbags-pip"}
NOT_IN_ROSDEP = {"altair", "vl_convert"}  # no key, see requirements/README.md
OF_EXTRAS = {"metadrive", "panda3d"}  # asked for where they are used, with a line that says how to install them
DISTRIBUTIONS = {"pydantic_core": "pydantic", "vl_convert": "vl-convert-python"}  # not called as their modules
NOT_IMPORTED = {"ackermann_msgs", "python3-pytest", "ros2launch", "rviz2", "std_msgs"}  # the last: headers of messages


def needed_by(package: str) -> set[str]:
    """Return the top-level modules that a package's code and launch files import."""
    modules = [module for folder in (package, "launch") for module in (SOURCE / package / folder).rglob("*.py")]
    return set().union(*map(imported, modules)) - {package} - OF_EXTRAS - set(sys.stdlib_module_names)


@pytest.mark.parametrize("package", PACKAGES)
def test_package_xml_is_valid(package):
    catkin = pytest.importorskip("catkin_pkg.package")
    warnings: list[str] = []
    manifest = catkin.parse_package(str(SOURCE / package), warnings=warnings)
    manifest.validate(warnings=warnings)
    assert warnings == []
    assert manifest.name == package
    assert manifest.licenses == ["Apache-2.0"]
    assert (SOURCE / package / "README.md").is_file()
    build_type = "ament_cmake" if package == "skd_msgs" else "ament_python"
    assert [export.content for export in manifest.exports if export.tagname == "build_type"] == [build_type]


def test_versions_agree():
    catkin = pytest.importorskip("catkin_pkg.package")
    versions = {str(catkin.parse_package(str(SOURCE / package)).version) for package in PACKAGES}
    versions |= {setup_section(package, "metadata")["version"] for package in PYTHON_PACKAGES}
    assert len(versions) == 1
    assert f'version = "{versions.pop()}"' in (SOURCE.parents[1] / "pyproject.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize("package", PYTHON_PACKAGES)
def test_dependencies_are_what_is_imported(package):
    catkin = pytest.importorskip("catkin_pkg.package")
    manifest = catkin.parse_package(str(SOURCE / package))
    declared = {dependency.name for dependency in (*manifest.exec_depends, *manifest.test_depends)}
    needed = {ROSDEP.get(name, name) for name in needed_by(package) - NOT_IN_ROSDEP}
    assert needed - declared == set(), "imported, but not in package.xml"
    assert declared - needed - NOT_IMPORTED == set(), "in package.xml, but not imported"
    missing = {DISTRIBUTIONS.get(name, name) for name in needed_by(package) & NOT_IN_ROSDEP}
    assert missing <= set(setup_section(package, "options")["install_requires"].split())


@pytest.mark.parametrize("node", ALL_NODES)
def test_parameter_file_agrees_with_the_declarations(node):
    on_file = defaults_on_file(node)
    assert on_file.pop("use_sim_time") is False
    tables = (CampaignOptions, SimulatorOptions, EvaluatorOptions)  # which no second place repeats
    elsewhere = {one.name for table in tables for one in options_of(table)}
    if node == "car_controller":  # its own controller and multiplier are others
        elsewhere = set()
    declared = {name: one.default for name, one in settings(node).items() if name not in elsewhere}
    assert on_file == declared
    assert [type(value) for value in on_file.values()] == [type(declared[name]) for name in on_file]


@pytest.mark.parametrize("node", ALL_NODES)
def test_declarations_are_sound(node):
    for name, setting in settings(node).items():
        descriptor = descriptor_of(setting)
        assert descriptor.description, name
        assert descriptor.read_only, name
        default = setting.plain_default
        if setting.texts:
            assert default in setting.texts, name
        if isinstance(default, (int, float)) and not isinstance(default, bool):
            assert setting.low <= default <= setting.high, name
            assert len(descriptor.integer_range) + len(descriptor.floating_point_range) == 1, name


def test_the_lock_file_is_of_the_dependencies_that_are_declared():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    declared = {re.split(r"[=<>;\[ ]", line)[0].lower() for line in project["dependencies"]}
    locked = (ROOT / "requirements" / "run.lock").read_text(encoding="utf-8")
    entries = re.split(r"^(?=[a-z])", locked, flags=re.MULTILINE)
    assert {one.split("==")[0] for one in entries if "skd (pyproject.toml)" in one} == declared

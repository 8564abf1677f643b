"""The Docker image, made step by step without Docker: colcon builds and tests, and containers run what is installed.

Its COPY and RUN steps, of the user that docker/Dockerfile makes, are run in a folder of their own. Where no ROS 2 is
sourced, this environment's takes the place of /opt/ros/jazzy. Packages of Python are those of this environment: SKD
alone is installed, by the steps themselves.
"""

import ast
import importlib.util
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import sysconfig
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from fnmatch import fnmatch
from pathlib import Path

import pytest
import yaml
from common import PATIENCE, new_domain
from packaging_support import ALL_NODES, NODES, PYTHON_PACKAGES, ROOT, SOURCE, check_command, tracked
from skd_evaluator.bags.read import read_bags
from skd_sim.ros_environment import installation

BIN = Path(sys.executable).parent
_PYTHON = """#!/bin/bash
# The Python that makes the image's environment: its packages come from the environment of the tests.
if [ "$1 $2" = "-m venv" ]; then
    {python} -m venv --without-pip "$3" && echo {packages} >"$3/lib/{version}/site-packages/of_the_tests.pth"
elif [ "$1 $2" = "-m pip" ]; then
    words=()
    for word; do [ "$word" = "numpy<2" ] || words+=("$word"); done
    exec {python} "${{words[@]}}" --no-deps --no-index --no-build-isolation
else
    exec {python} "$@"
fi
"""
_NO_CPP = r"""
list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX "^rosidl_typesupport_.*cpp:")
"""
"""Messages get their headers for C++, but not the libraries by which it sends them: no node here is written in it."""


def instructions(text: str) -> list[tuple[str, str]]:
    """Return a Dockerfile's instructions and their arguments."""
    lines = "\n".join(line for line in text.splitlines() if not line.startswith("#"))
    found = (line.strip() for line in re.sub(r"\\\n\s*", "", lines).splitlines())
    return [(word, rest.strip()) for word, _, rest in (line.partition(" ") for line in found if line)]


DOCKERFILE = instructions((ROOT / "docker" / "Dockerfile").read_text(encoding="utf-8"))
HOME = next(rest for word, rest in DOCKERFILE if word == "WORKDIR")


def value(word: str) -> list[str]:
    """Return the words of the last instruction of a kind, which is a list in JSON, perhaps behind options."""
    (rest,) = [rest for name, rest in DOCKERFILE if name == word]
    return list(json.loads(rest[rest.index("[") :]))


def context() -> list[str]:
    """Return the files that a build sees, by their names in the checkout: what .dockerignore lists is not there."""
    ignored = (ROOT / ".dockerignore").read_text(encoding="utf-8").split()

    def is_ignored(name: str) -> bool:
        parts = name.split("/")
        paths = ["/".join(parts[: end + 1]) for end in range(len(parts))]
        return any(
            fnmatch(part, pattern[3:]) if pattern.startswith("**/") else fnmatch(path, pattern)
            for pattern in ignored
            for path, part in zip(paths, parts, strict=True)
        )

    return [name for name in tracked() if not is_ignored(name)]


@dataclass(frozen=True)
class Image:
    folder: Path
    variables: dict[str, str]

    @property
    def workspace(self) -> Path:
        return self.folder / "ros_ws"

    def executable(self, package: str, name: str) -> Path:
        return self.workspace / "install" / package / "lib" / package / name

    def start(self, *command: object, **variables: str) -> subprocess.Popen[str]:
        """Start a container's command: by the entry point, in the working folder."""
        words = [*map(self.local, value("ENTRYPOINT")), *map(str, command)]
        how = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        return subprocess.Popen(words, cwd=self.folder, env=self.variables | variables, start_new_session=True, **how)

    def run(self, *command: object, **variables: str) -> subprocess.CompletedProcess[str]:
        with self.start(*command, **variables) as process:
            try:
                output, _ = process.communicate(timeout=PATIENCE)
            finally:
                signal_group(process, signal.SIGKILL)
        lines = [line for line in output.splitlines(keepends=True) if "RTPS_TRANSPORT_SHM" not in line]  # not our words
        return subprocess.CompletedProcess(process.args, process.returncode, "".join(lines))

    def local(self, text: str) -> str:
        """Return a text with the image's paths as they are here."""
        text = text.replace(HOME, str(self.folder)).replace(" /tmp/", f" {self.folder}/tmp/")
        return text if installation.is_sourced() else text.replace("/opt/ros/", f"{self.folder}/opt/ros/")


def signal_group(process: subprocess.Popen[str], number: int) -> None:
    """Signal a process and what it has started, as Ctrl-C in a terminal does; nothing where all of it has ended."""
    with suppress(ProcessLookupError):
        os.killpg(process.pid, number)


@contextmanager
def image_folder(empty: Path) -> Iterator[Path]:
    """Yield where to build: a folder of the environment that has but a messages' package that was built before.

    It is named for all that decides how the messages are built. Where a ROS 2 is sourced, `empty` takes its place.
    """
    if installation.is_sourced():
        yield empty
        return
    folder = Path(sys.prefix, "image", installation.environment_digest()[:16])
    folder.mkdir(parents=True, exist_ok=True)
    with installation.locked(folder / ".lock", "building the image"):
        built = folder / "ros_ws" / "install" / "skd_msgs"
        kept = {"opt", "ros_ws"} if built.exists() else set()
        old = [one for one in folder.iterdir() if one.name not in {".lock", *kept}]
        for one in (*old, *folder.glob("ros_ws/[!bi]*"), *folder.glob("ros_ws/[bi]*/skd_[!m]*")):
            shutil.rmtree(one) if one.is_dir() else one.unlink()
        yield folder


def build_image(folder: Path) -> Image:
    """Take the steps of the Dockerfile in a folder of `image_folder`."""
    image = Image(folder, _variables(folder))
    (folder / "tmp").mkdir()
    user = ""
    for word, rest in DOCKERFILE:
        if word == "USER":
            user = rest
        if not user or word not in ("COPY", "RUN"):
            continue  # of the system, or no step
        if word == "COPY":
            _copy(image, [part for part in rest.split() if not part.startswith("--")])
            continue
        done = subprocess.run(
            ["/bin/bash", "-c", image.local(rest)],
            cwd=folder, env=image.variables, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=PATIENCE,
        )  # fmt: skip
        assert done.returncode == 0, f"{word} {rest}\n{done.stdout[-3000:]}{done.stderr[-3000:]}"
    return image


def _copy(image: Image, words: list[str]) -> None:
    """Copy files of the build's context, as COPY does: the content of a folder, each file by its own name."""
    *sources, target = words
    into = image.folder / target
    for source in sources:
        names = [name for name in context() if source == "." or name == source or name.startswith(f"{source}/")]
        assert names, f"COPY {source}: not in the build's context"
        for name in names:
            place = into / (
                Path(name).name if name == source else name if source == "." else Path(name).relative_to(source)
            )
            place.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, place)
            if place.suffix == ".sh":
                place.write_text(image.local(place.read_text(encoding="utf-8")), encoding="utf-8")


def _variables(folder: Path) -> dict[str, str]:
    """Return a container's variables, and make what stands for the system's part of the image."""
    ours = {key: text for key, text in os.environ.items() if not key.startswith(("SKD_", "COLCON_", "PYTHON"))}
    if "SKD_CACHE_DIR" in os.environ:
        ours["SKD_CACHE_DIR"] = os.environ["SKD_CACHE_DIR"]
    ours |= {"ROS_DOMAIN_ID": str(new_domain()), "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    python = folder / "python"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    here, packages = shlex.quote(sys.executable), shlex.quote(sysconfig.get_paths()["purelib"])
    python.write_text(_PYTHON.format(python=here, packages=packages, version=version))
    python.chmod(0o755)
    ours["SKD_PYTHON"] = str(python)
    if installation.is_sourced():
        return {**ours, "PATH": os.pathsep.join(part for part in ours["PATH"].split(os.pathsep) if Path(part) != BIN)}
    prefix = folder / "opt" / "ros" / "jazzy"
    if not prefix.exists():
        prefix.mkdir(parents=True)
        installation.cmake_prefix(prefix)
        generators = prefix / "share/rosidl_default_generators/cmake/rosidl_default_generatorsConfig.cmake"
        generators.write_text(generators.read_text(encoding="utf-8") + _NO_CPP, encoding="utf-8")
    sourced = {
        "ROS_DISTRO": "jazzy",
        "AMENT_PREFIX_PATH": str(prefix),
        "CMAKE_PREFIX_PATH": str(prefix),
        "CMAKE_GENERATOR": "Ninja",
        "VIRTUAL_ENV": sys.prefix,  # where CMake looks for Python
        "LD_LIBRARY_PATH": installation.node_variables({})["LD_LIBRARY_PATH"],
    }
    lines = [f"export {name}={shlex.quote(text)}" for name, text in sourced.items()]
    (prefix / "setup.bash").write_text("\n".join([*lines, f'export PATH={shlex.quote(str(BIN))}:"$PATH"', ""]))
    return ours


SERVICES = yaml.safe_load((ROOT / "docker" / "compose.yaml").read_text(encoding="utf-8"))["services"]
LAUNCH = ("launch", "launch_ros", "ros2cli", "ros2launch", "ros2run")
NOT_FOUND = [name for name in LAUNCH if importlib.util.find_spec(name) is None]
needs_launch = pytest.mark.skipif(
    bool(NOT_FOUND), reason=f"not found: {', '.join(NOT_FOUND)}; they come with a ROS 2 that is sourced"
)
needs_compiler = pytest.mark.skipif(
    not (shutil.which("bash") and shutil.which("c++") and shutil.which("git")), reason="needs bash, git and c++"
)


@pytest.fixture(scope="session")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Image]:
    installation.ensure_ros()
    with image_folder(tmp_path_factory.mktemp("image")) as folder:
        yield build_image(folder)


def settings(safe: Path, out: Path) -> dict[str, object]:
    """The same for the evaluator, as parameters or launch arguments."""
    return {"safe": safe, "multiplier": 0.5, "seed": 3, "simulations": 300, "out": out}


def command(service: str, image: Image) -> list[object]:
    """Return the command of one of compose's services, with defaults of variables; without ros2cli, its executable."""
    words: list[object] = list(shlex.split(re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", SERVICES[service]["command"])))
    if words[:2] == ["ros2", "run"] and NOT_FOUND:
        return [image.executable(str(words[2]), str(words[3])), *words[4:]]
    return words


def test_compose_has_one_service_a_node():
    nodes = {name for name, service in SERVICES.items() if service["command"].startswith("ros2 run skd_")}
    assert nodes == set(NODES)
    assert set(SERVICES) - nodes == {"external_controller"}
    for name, service in SERVICES.items():
        assert service["image"] == "skd"
        check_command(re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", service["command"]))
        if name in nodes:
            assert service["command"].split(" --ros-args")[0].split()[-1] == name
    assert SERVICES["vehicle_simulator"]["build"] == {"context": "..", "dockerfile": "docker/Dockerfile"}


def test_what_takes_long_does_not_depend_on_what_changes_often():
    steps = [f"{word} {rest}" for word, rest in DOCKERFILE]
    everything = next(number for number, step in enumerate(steps) if step.endswith(" . ."))
    assert any("skd_environment" in step for step in steps[:everything])
    assert any("colcon build" in step for step in steps[:everything])
    assert not [name for name in context() if name.startswith((".venv", "tests/", "docs/"))]
    assert [rest for word, rest in DOCKERFILE if word == "USER"] == ["skd"]


@needs_compiler
def test_everything_is_installed(image):
    for package in PYTHON_PACKAGES:
        names = {name for name, (where, _) in ALL_NODES.items() if where == package}
        names |= {"skd"} if package == "skd_evaluator" else set()
        assert {path.name for path in image.executable(package, "any").parent.iterdir()} == names
    found = image.run("python3", "-c", "import skd_sim, skd_adversary, skd_evaluator, skd_msgs as m; print(m, skd_sim)")
    assert found.stdout.count(str(image.workspace / "install")) == 2, "and not what the environment has of them"
    assert set(map(str, (image.folder / ".venv-jazzy").rglob("skd_evaluator"))) == set()


@needs_compiler
def test_colcon_test(image):
    """In one process a package, which has the environment of the tests: the image has no pytest."""
    done = image.run(
        sys.executable, BIN / "colcon", "test", "--return-code-on-test-failure", "--event-handlers", "console_direct+",
        "--base-paths", "ros_ws/src", "--build-base", "ros_ws/build", "--install-base", "ros_ws/install",
        SKD_TEST_DOMAIN=str(new_domain()), PYTEST_DISABLE_PLUGIN_AUTOLOAD="1",
    )  # fmt: skip
    assert done.returncode == 0, done.stdout[-6000:]
    for package in PYTHON_PACKAGES:
        (suite,) = ElementTree.parse(image.workspace / "build" / package / "pytest.xml").findall("testsuite")
        assert int(suite.attrib["tests"]) == len(suite.findall("testcase")) > 0
        assert [suite.attrib[name] for name in ("errors", "failures", "skipped")] == ["0", "0", "0"]


@needs_compiler
def test_a_node_of_others_runs_in_a_container_of_its_own(image, safe, tmp_path):
    """By the commands that compose gives the containers, and by the environment's ROS 2 for the node of others."""
    domain = {"ROS_DOMAIN_ID": str(new_domain())}
    with ExitStack() as ending:
        for name in ("vehicle_simulator", "adversary", "external_controller"):
            process = image.start(*command(name, image), **domain)
            ending.callback(process.communicate)
            ending.callback(signal_group, process, signal.SIGKILL)
        given = {**settings(safe, tmp_path / "out"), "task": "episode", "controller": "external"}
        words = [word for name, text in given.items() for word in ("-p", f"{name}:={text}")]
        done = image.run(*command("evaluator", image), *words, "-p", "adversary_model:=generic", **domain)
    assert done.returncode == 0, done.stdout
    (recorded,) = read_bags([tmp_path / "out" / "bags"]).episodes
    assert recorded.log.outcome.name.lower() == json.loads((tmp_path / "out" / "episode.json").read_text())["outcome"]


@needs_compiler
def test_a_container_is_healthy(image):
    healthy = image.run(*value("HEALTHCHECK")[1:])
    assert healthy.returncode == 0, healthy.stdout
    assert "round trip: a message between two nodes came" in healthy.stdout


@needs_launch
@needs_compiler
@pytest.mark.parametrize("task", ["episode", "assessment"])
def test_arguments_of_launch_files_are_shown(image, task):
    done = image.run("ros2", "launch", "skd_evaluator", f"{task}.launch.py", "--show-args")
    assert done.returncode == 0, done.stdout
    assert re.search(r"'objective':\s+.*'paper', 'frechet'", done.stdout)
    assert not re.search(r"<\w+\.\w+: ", done.stdout), "choices are shown as they are written"


@needs_launch
@needs_compiler
def test_launch_runs_an_episode(image, safe, tmp_path):
    given = {"startup_timeout": PATIENCE, **settings(safe, tmp_path / "out")}
    arguments = [f"{name}:={text}" for name, text in given.items()]
    done = image.run("ros2", "launch", "skd_evaluator", "episode.launch.py", *arguments)
    assert done.returncode == 0, done.stdout
    assert (tmp_path / "out" / "episode.json").is_file()


EXAMPLE = ROOT / "examples" / "launch_test" / "test_safety.py"


@needs_launch
@needs_compiler
def test_the_example_of_a_launch_test_passes(image):
    done = image.run("python3", "-m", "launch_testing.launch_test", EXAMPLE)
    assert done.returncode == 0, done.stdout


def test_the_example_of_a_launch_test_uses_what_there_is():
    """By its syntax: here there may be no `launch`."""
    module = SOURCE / "skd_evaluator" / "skd_evaluator" / "ros" / "launch_testing.py"
    defined = {one.name for one in ast.parse(module.read_text()).body if isinstance(one, ast.FunctionDef)}
    (ours,) = [
        node for node in ast.walk(ast.parse(EXAMPLE.read_text()))
        if isinstance(node, ast.ImportFrom) and node.module == "skd_evaluator.ros.launch_testing"
    ]  # fmt: skip
    assert {name.name for name in ours.names} == defined

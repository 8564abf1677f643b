"""Extensions can be deleted: the rest neither imports nor needs them."""

import json
import re
import shutil
from pathlib import Path

import pytest
import skd_evaluator
from cli_support import SMALL
from cli_support import skd_from_nothing as skd

PACKAGE = Path(skd_evaluator.__file__).parent
COMMANDS = {
    "campaign": ["campaign", "benchmark"],
    "exchange": ["export", "import"],
    "fusion": ["fuse"],
    "log": ["log"],
    "protocols": ["protocol"],
}


def copied(folder: Path) -> Path:
    """A copy of the package, which a process in this folder imports in place of the other; compiled files, too."""
    shutil.copytree(PACKAGE, folder / PACKAGE.name, ignore=shutil.ignore_patterns("*.pyc.*"))  # which others write now
    return folder / PACKAGE.name


def test_each_folder_is_an_extension():
    folders = {path.name for path in (PACKAGE / "extensions").iterdir() if path.is_dir() and path.name[0] != "_"}
    assert folders == set(COMMANDS)


@pytest.mark.parametrize("name", COMMANDS)
def test_an_extension_is_imported_by_itself_alone(name: str):
    own = PACKAGE / "extensions" / name
    users = [path for path in PACKAGE.rglob("*.py") if f"extensions.{name}" in path.read_text("utf-8")]
    assert users
    assert all(own in path.parents for path in users)


@pytest.mark.parametrize("name", COMMANDS)
def test_help_does_without_an_extension(name: str, tmp_path: Path):
    package = copied(tmp_path)
    shutil.rmtree(package / "extensions" / name)
    done = skd("--help-all", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    for extension, commands in COMMANDS.items():
        for command in commands:
            assert (re.search(rf"^  {command}\b", done.stdout, re.MULTILINE) is not None) == (extension != name)


def test_cars_are_assessed_and_reported_without_any_extension(tmp_path: Path):
    shutil.rmtree(copied(tmp_path) / "extensions")
    done = skd("assess", *SMALL, "--out", "result", "--no-pictures", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads((tmp_path / "result" / "assessment.json").read_text("utf-8"))["controller"] == "basic"
    assert skd("report", "result", "--out", "page.html", cwd=tmp_path).returncode == 0
    assert "The regulator's view" not in (tmp_path / "page.html").read_text("utf-8")


OWN = '''"""A command of one file."""


def add(parser):
    """Greet a user.

    Greet a name, as often as is requested.
    """
    parser.set_defaults(group="look")
    parser.add_argument("--times", type=int, default=1, help="how often")


def run(arguments):
    """Run the command."""
    print("hello " * arguments.times)
    return 3
'''


def test_a_command_is_one_file(tmp_path: Path):
    package = copied(tmp_path)
    (package / "cli" / "commands" / "greet.py").write_text(OWN)
    assert re.search(r"^  greet +greet a user$", skd("--help", cwd=tmp_path).stdout, re.MULTILINE)
    assert "Greet a name, as often as is requested." in skd("greet", "--help", cwd=tmp_path).stdout
    done = skd("greet", "--times", "2", cwd=tmp_path)
    assert (done.returncode, done.stdout.split(), done.stderr) == (3, ["hello", "hello"], "")

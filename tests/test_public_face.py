"""What packages offer their users by name."""

import ast
import importlib
import subprocess
import sys
from pathlib import Path

import pytest

FACES = ("skd_sim", "skd_adversary", "skd_evaluator")


@pytest.mark.parametrize("package", FACES)
def test_every_name_is_there_and_is_what_type_checkers_see(package):
    module = importlib.import_module(package)
    stub = ast.parse(Path(module.__file__).with_suffix(".pyi").read_text())
    typed = {name.name: one.module for one in stub.body if isinstance(one, ast.ImportFrom) for name in one.names}
    assert sorted(typed) == module.__all__
    for name, where in typed.items():
        assert getattr(module, name) is getattr(importlib.import_module(where), name)
        assert name in dir(module)
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        module.nonsense  # noqa: B018


@pytest.mark.parametrize("package", FACES)
def test_its_import_is_light(package):
    code = f"import sys, {package}; print(sorted({{'numpy', 'numba', 'scipy', 'rclpy'}} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"

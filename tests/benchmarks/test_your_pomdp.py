"""The code of docs/extending.md, run as it stands, against the optimum of its problem."""

import math
import sys
import types
from pathlib import Path

import numpy as np
import pytest

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
FAULTY, ACCURACY, GAMMA = 0.3, 0.8, 0.99


def _optimum() -> float:
    """Value iteration over how many more tests said "faulty" than not: with the prior, a sufficient statistic."""
    top = 60
    differences = np.arange(-top, top + 1)
    odds = FAULTY / (1.0 - FAULTY) * (ACCURACY / (1.0 - ACCURACY)) ** differences.astype(float)
    faulty = odds / (1.0 + odds)
    stop = np.maximum(0.0, 10.0 - 60.0 * faulty)
    up = faulty * ACCURACY + (1.0 - faulty) * (1.0 - ACCURACY)
    value = stop
    for _ in range(500):
        ahead = up * np.append(value[1:], value[-1]) + (1.0 - up) * np.append(value[0], value[:-1])
        value = np.maximum(stop, -1.0 + GAMMA * ahead)
    return float(value[top])


def _example(number: int, name: str, folder: Path) -> types.ModuleType:
    code = PAGE.read_text(encoding="utf-8").split("<!-- run -->\n```python\n")[number].split("```", 1)[0]
    assert len([line for line in code.splitlines() if line.strip()]) <= 60
    path = folder / f"{name}.py"  # numba caches code that has a file
    path.write_text(code, encoding="utf-8")
    module = types.ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    exec(compile(code, str(path), "exec"), module.__dict__)
    return module


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> types.ModuleType:
    return _example(1, "inspection", tmp_path_factory.mktemp("page"))


def test_the_page_reaches_the_optimum(page: types.ModuleType) -> None:
    optimum = _optimum()
    assert optimum == pytest.approx(2.18, abs=0.5)  # testing pays: shipping at once would lose 8, scrapping yields 0
    values = np.array([page.episode(seed) for seed in range(400)])
    error = values.std(ddof=1) / math.sqrt(len(values))
    # 3.5 standard errors either way, and a tenth of the optimum for what a finite search loses in near ties.
    assert optimum * 0.9 - 3.5 * error <= values.mean() <= optimum + 3.5 * error


def test_same_seed_same_return(page: types.ModuleType) -> None:
    assert page.episode(5) == page.episode(5)

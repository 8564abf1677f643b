"""A plug-in of pytest: a car is assessed by a test, which asks for its figures.

    def test_my_car(skd):
        assert skd.assess(MyCar, safe_count=10).margin > 0.8

Light, for every pytest of an environment with SKD begins with it.
"""

from __future__ import annotations

import numbers
import operator
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest
from skd_sim.errors import AssessmentError, UsageError

_OUT = "--skd-out"
__tracebackhide__ = True  # pytest shows the test's own line, not those of this module


class Unsure:
    """A figure that aborted episodes, or a longer search for the margin, would change: it is shown, but no number.

    It is compared with numbers alone, as both of what it may be.

    Raises:
        AssessmentError: by one of them a comparison holds and by the other it does not, or it is used in another way.
    """

    __hash__ = None  # type: ignore[assignment]
    __array_ufunc__ = None  # NumPy leaves comparison and arithmetic to this class

    def __init__(self, value: float, name: str, worst: float | None, why: str) -> None:
        """Take what the figure is, what it may be (None: not known), and why."""
        self._value, self._name, self._worst, self._why = value, name, worst, why

    def __repr__(self) -> str:
        return repr(self._value)

    def __format__(self, spec: str) -> str:
        return format(self._value, spec)

    def _refuse(self, *_others: object, **_options: object) -> Any:
        raise AssessmentError(f"not judged: {self._name} is {self._value:.6g}, and {self._why}")

    def _compare(self, holds: Callable[[Any, Any], Any], other: Any) -> bool:
        is_number = isinstance(other, numbers.Real)
        if self._worst is None or not is_number:
            return bool(self._refuse())
        low, high = sorted((self._value, self._worst))
        exact = holds in (operator.eq, operator.ne)  # between the two it may hold as well
        if (low <= other <= high) if exact else holds(low, other) != holds(high, other):
            self._refuse()
        return bool(holds(self._value, other))

    def __bool__(self) -> bool:
        return self._compare(operator.ne, 0.0)


def _compares(holds: Callable[[Any, Any], Any]) -> Callable[[Unsure, Any], bool]:
    return lambda self, other: self._compare(holds, other)


for _name in ("lt", "le", "gt", "ge", "eq", "ne"):
    setattr(Unsure, f"__{_name}__", _compares(getattr(operator, _name)))
for _name in ("add", "sub", "mul", "truediv", "floordiv", "mod", "divmod", "pow"):
    setattr(Unsure, f"__{_name}__", Unsure._refuse)
    setattr(Unsure, f"__r{_name}__", Unsure._refuse)
for _name in ("neg", "pos", "abs", "float", "int", "complex", "index", "round", "trunc", "array"):
    setattr(Unsure, f"__{_name}__", Unsure._refuse)


def _guarded(figures: Mapping[str, Any], value: Any, path: tuple[str, ...]) -> Any:
    """Return a value of assessment.json with the figures in it that are not sure in their place."""
    if isinstance(value, dict):
        return {key: _guarded(figures, one, (*path, key)) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return type(value)(_guarded(figures, one, (*path, str(place))) for place, one in enumerate(value))
    if not isinstance(value, float):
        return value
    from skd_evaluator.assessment.compare.gate import bound_of
    from skd_evaluator.metrics.aborted import at_worst

    name = ".".join(path)
    whole = name.partition("_ci95")[0]  # the ends of an interval hang on what its figure hangs on
    if worst := at_worst(figures, whole):
        would = "it would be" if whole == name else f"{whole} would be"
        why = f"{would} {worst.value:.6g} if the car had hit in the {worst.of} that were aborted"
        return Unsure(value, name, worst.value if whole == name else None, why)
    bound = bound_of(figures, whole)
    return value if bound is None else Unsure(value, name, bound.beyond, bound.why)


_NOTES = {"margin": "margin_note", "risk_1": "risk_note", "time_lost": "price_note"}


class Assessed:
    """An assessment: every key of assessment.json is an attribute, and what fails shows the sentence about the car.

    A figure that episodes count for of which some were aborted is `Unsure`, as is a margin whose search has not
    converged: it is shown, and compared with numbers where that comes out the same had the car hit in all of these,
    or the search gone on; everything else raises `AssessmentError`. `figures` has it as it is.

    Attributes:
        figures: content of assessment.json.
        folder: folder with all of it.
    """

    def __init__(self, figures: dict[str, Any], folder: Path) -> None:
        """Take the figures of an assessment, which is written already."""
        self.figures = figures
        self.folder = folder

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name not in self.figures:
            from skd_evaluator.assessment.files.assessment_json import near_figure

            raise AttributeError(f"an assessment has no figure {name!r}{near_figure(name)}")
        if self.figures[name] is None and (why := self.figures.get(_NOTES.get(name, ""))):
            raise AssessmentError(f"{name} is not known: {why}")
        return _guarded(self.figures, self.figures[name], (name,))

    def __repr__(self) -> str:
        from skd_evaluator.report.terminal import headline

        return f"<{headline(self.figures)} See {self.folder}>"

    def is_worse_than(self, earlier: str | Path) -> str:
        """Return by what the car fell behind an earlier result, as `--fail-if-worse-than` judges; empty if it did not.

        So a test that fails shows it. What has to be said beside that is a warning of Python's.

        Raises:
            AssessmentError: nothing can be said, as where the two do not compare: neither that it is worse nor that it
                is not.
        """
        from skd_evaluator.assessment.files.results import read_result
        from skd_evaluator.margin.common_trajectories import check_not_worse

        check = _called(lambda: check_not_worse(self.folder, read_result(Path(earlier).expanduser())))
        if check.error:
            raise AssessmentError("; ".join((f"{check.name}: {check.text}", *check.remarks)))
        if check.remarks:
            warnings.warn(f"compared with {earlier}: {'; '.join(check.remarks)}", stacklevel=2)
        return check.text if check.failed else ""


def _called(work: Callable[[], Any]) -> Any:
    """Return what a function of SKD's does; what it raises for the user comes without its own frames."""
    try:
        return work()
    except (AssessmentError, UsageError) as error:
        raise error.with_traceback(None) from None


class Assessor:
    """What the fixture `skd` is."""

    def __init__(self, out: Path) -> None:
        """Assess into new folders in `out`."""
        self._out = out
        self._kept: dict[str, Assessed] = {}
        self._failed: dict[str, str] = {}

    def assess(self, car: type | str = "basic", **options: Any) -> Assessed:
        """Assess a car as `skd_evaluator.assess` does; the same again, in the same run of pytest, is not run again.

        Args:
            car: a class with `reset` and `command`, in a module that can be imported, or what `--controller` takes.
            options: those of `skd_evaluator.assess`.

        Raises:
            AssessmentError: its figures are not credible, or `skd assess` would end with exit code 1 for
                another reason, so that no test of them says anything.
        """
        from skd_evaluator.library import assess
        from skd_evaluator.metrics.aborted import not_credible
        from skd_evaluator.report.warnings import undefined

        if not isinstance(car, (str, type)) or "<locals>" in getattr(car, "__qualname__", ""):
            raise UsageError(f"skd.assess takes a class of a module's top level, or its name, got {car!r}")
        controller = car if isinstance(car, str) else f"{car.__module__}:{car.__qualname__}"
        key = f"{controller} {sorted(options.items())!r}"
        if key not in self._kept:
            folder = self._out / f"{len(self._kept)}"
            assessment = _called(lambda: assess(controller, out=folder, **options))
            self._kept[key] = Assessed(assessment.as_dict(), folder)
            figures = self._kept[key].figures
            nothing = undefined(figures) if figures["margin"] is None else None
            self._failed[key] = "; ".join(filter(None, [*not_credible(figures.get("warnings") or ()), nothing]))
        if why := self._failed[key]:
            raise AssessmentError(f"{controller}: {why}. See {self._kept[key].folder}")
        return self._kept[key]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --skd-out."""
    text = "keep the results of the fixture skd in this new folder (default: pytest's temporary folder)"
    parser.getgroup("skd", "SKD").addoption(_OUT, metavar="DIR", help=text)


@pytest.fixture(scope="session", name="skd")
def _skd(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Assessor:
    """Assess cars: `skd.assess(MyCar).margin`."""
    out, worker = request.config.getoption(_OUT), getattr(request.config, "workerinput", {}).get("workerid", "")
    if not out:
        return Assessor(tmp_path_factory.mktemp("skd"))
    # From where pytest was started: a test may have gone to another folder.
    folder = request.config.invocation_params.dir / Path(out).expanduser() / worker
    if folder.is_dir() and any(folder.iterdir()):
        pytest.exit(f"{_OUT} {out}: already holds results; name a new folder, or delete it", 2)
    return Assessor(folder)

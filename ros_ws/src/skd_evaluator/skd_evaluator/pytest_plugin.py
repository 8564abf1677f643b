"""A plug-in of pytest: a car is assessed by a test, which asks for its figures.

    def test_my_car(skd):
        assert skd.assess(MyCar, safe_count=10).margin > 0.8

Light, for every pytest of an environment with SKD begins with it.
"""

from __future__ import annotations

import operator
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from typing import Self

    from skd_evaluator.campaign.judge.rating import Rating
    from skd_evaluator.measure.aborted import Worst

_OUT = "--skd-out"


class _AtWorst(float):
    """A figure that would be another one if the car had hit in every episode that was aborted: it is compared as both.

    Raises:
        AssessmentError: by one of them a comparison holds, and by the other it does not.
    """

    def __new__(cls, value: float, _name: str, _worst: Worst) -> Self:
        return super().__new__(cls, value)

    def __init__(self, value: float, name: str, worst: Worst) -> None:
        self._value, self._name, self._worst = value, name, worst

    def _judged(self, holds: Callable[[float, float], bool], other: Any) -> Any:
        from skd_evaluator.errors import AssessmentError

        if not isinstance(other, (int, float)):
            return NotImplemented
        found = holds(self._value, other)
        if holds(self._worst.value, other) != found:
            raise AssessmentError(
                f"not judged: {self._name} is {self._value:.6g}, and it would be {self._worst.value:.6g} if the car "
                f"had hit in the {self._worst.of} that were aborted"
            )
        return found

    def __lt__(self, other: Any) -> bool:
        return self._judged(operator.lt, other)  # type: ignore[no-any-return]

    def __le__(self, other: Any) -> bool:
        return self._judged(operator.le, other)  # type: ignore[no-any-return]

    def __gt__(self, other: Any) -> bool:
        return self._judged(operator.gt, other)  # type: ignore[no-any-return]

    def __ge__(self, other: Any) -> bool:
        return self._judged(operator.ge, other)  # type: ignore[no-any-return]


class Assessed:
    """An assessment: every key of assessment.json is an attribute, and what fails shows the sentence about the car.

    A figure that episodes count for of which some were aborted is no other number, but `<` and the like raise
    `AssessmentError` where they would come out otherwise had the car hit in all of these.

    Attributes:
        figures: content of assessment.json.
        folder: folder with all of it.
    """

    def __init__(self, rating: Rating, folder: Path) -> None:
        """Take a rating, which is written already."""
        self.figures: dict[str, Any] = rating.as_dict()
        self.folder = folder

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name not in self.figures:
            raise AttributeError(f"an assessment has no figure {name!r}; docs/files.md has the list")
        value = self.figures[name]
        if not isinstance(value, float):
            return value
        from skd_evaluator.measure.aborted import at_worst

        worst = at_worst(self.figures, name)
        return value if worst is None else _AtWorst(value, name, worst)

    def __repr__(self) -> str:
        from skd_evaluator.report.terminal import headline

        return f"<{headline(self.figures)} See {self.folder}>"

    def is_worse_than(self, earlier: str | Path) -> bool:
        """Return whether the car fell behind an earlier result, as the gate `--fail-if-worse-than` judges.

        What has to be said beside that is a warning of Python's.

        Raises:
            AssessmentError: nothing can be said, as where the two do not compare: neither that it is worse nor that it
                is not.
        """
        from skd_evaluator.campaign.compare.gate import check_not_worse
        from skd_evaluator.campaign.store.stored_result import read_result
        from skd_evaluator.errors import AssessmentError

        check = check_not_worse(self.folder, read_result(Path(earlier).expanduser()))
        if check.error:
            raise AssessmentError(f"{check.name}: {check.text}")
        if "; " in check.text:  # more than the verdict and its interval
            warnings.warn(f"{check.name}: {check.text}", stacklevel=2)
        return check.failed


class Skd:
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
        from skd_evaluator.assessing.findings import undefined
        from skd_evaluator.assessing.library import assess
        from skd_evaluator.errors import AssessmentError
        from skd_evaluator.measure.credibility import not_credible

        controller = car if isinstance(car, str) else f"{car.__module__}:{car.__qualname__}"
        key = f"{controller} {sorted(options.items())!r}"
        if key not in self._kept:
            folder = self._out / f"{len(self._kept)}"
            rating = assess(controller, out=folder, **options)
            self._kept[key] = Assessed(rating, folder)
            lines = not_credible(self._kept[key].figures.get("warnings") or ())
            self._failed[key] = "; ".join([*lines, *filter(None, [undefined(rating)])])
        if why := self._failed[key]:
            raise AssessmentError(f"{controller}: {why}. See {self._kept[key].folder}")
        return self._kept[key]


def pytest_addoption(parser: pytest.Parser) -> None:
    """Add --skd-out."""
    text = "keep the results of the fixture skd in this new folder (default: pytest's temporary folder)"
    parser.getgroup("skd", "SKD").addoption(_OUT, metavar="DIR", help=text)


@pytest.fixture(scope="session", name="skd")
def _skd(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Skd:
    """Assess cars: `skd.assess(MyCar).margin`."""
    out, worker = request.config.getoption(_OUT), getattr(request.config, "workerinput", {}).get("workerid", "")
    if not out:
        return Skd(tmp_path_factory.mktemp("skd"))
    # From where pytest was started: a test may have gone to another folder.
    return Skd(request.config.invocation_params.dir / Path(out).expanduser() / worker)

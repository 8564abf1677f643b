"""Mutation score of the measure and the planner: small faults are put into a module, one at a time; do its tests fail?

Cosmic Ray (MIT) makes the mutants: it works on source, so that kernels behind a decorator are reached, and gives each
mutation a name and a number. Its own way of running them starts Python anew for each, which takes longer than the
tests; here a process that has everything imported but the packages under test forks a child for each, and the source
tree is never touched. Kernels run as plain Python (NUMBA_DISABLE_JIT): compiling takes longer than running them.

Left out are mutations that no test can miss or none can see: operators on bits and `is` in place of arithmetic and
comparisons, which raise an error on floats, those of annotations, and decorators removed.

    scripts/mutants [MODULE...] [--sample N] [--out FILE]
"""

from __future__ import annotations

import argparse
import difflib
import importlib
import importlib.machinery
import json
import os
import random
import re
import resource
import signal
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

import pytest
from hypothesis import HealthCheck, Phase, settings

ROOT = Path(__file__).resolve().parent.parent
SOURCE = ROOT / "ros_ws" / "src"
_NOT_LOADED = 98  # an exit code
MEMORY = 6 * 2**30  # bytes that a mutant may take
_ARITHMETIC = "Add|Sub|Mul|Div|FloorDiv"
_ORDER = "Eq|NotEq|Lt|LtE|Gt|GtE"
_USED = re.compile(
    rf"core/(ReplaceBinaryOperator_({_ARITHMETIC}|Mod|Pow)_({_ARITHMETIC})|ReplaceComparisonOperator_({_ORDER})_({_ORDER})"
    r"|ReplaceComparisonOperator_Is(Not)?_Is(Not)?|ReplaceUnaryOperator_(USub_UAdd|Delete_USub|Delete_Not)|AddNot"
    r"|ReplaceTrueWithFalse|ReplaceFalseWithTrue|ReplaceAndWithOr|ReplaceOrWithAnd|ReplaceBreakWithContinue"
    r"|ReplaceContinueWithBreak|NumberReplacer|ZeroIterationForLoop)$"
)


@dataclass(frozen=True)
class Target:
    """A module and the tests that are to notice its faults, quick ones first."""

    module: str
    tests: tuple[str, ...]
    options: tuple[str, ...] = ()

    @property
    def path(self) -> Path:
        package, *_ = self.module.split(".")
        return SOURCE / package / (self.module.replace(".", "/") + ".py")


def _evaluator(name: str) -> str:
    return f"tests/evaluator/test_{name}.py"


_FRECHET = (_evaluator("frechet"), _evaluator("skd"))
_SMALL_CURVES = ("-k", "not leaving_cells_out or 5-90 or 64-31")  # of 100 points and more: half a minute
_SLOW_PLANNING = "root_value or after_each_count or near_tie or expected_return or gathers or opens_once or useless"
_PLANNER = ("tests/adversary/test_search_tree.py", "tests/adversary/test_search.py", "tests/adversary/test_planner.py")
_QUICK_PLANNING = ("-k", f"not ({_SLOW_PLANNING} or after_each_observation)")
_ROLLOUTS = ("tests/adversary/test_learning_rollouts.py", "tests/adversary/test_search.py")
_LEARNING = ("-k", "learning_rollouts or (readable and default)")
_ROOT = ("tests/adversary/test_other_planners.py", *_PLANNER[1:])
_ROOT_ONLY = ("-k", f"(root or same_generator or counted_once or readable) and not ({_SLOW_PLANNING})")
_KERNELS_ONLY = (
    "leaving_cells_out or pseudometric or similaritymeasures or lies_between or shapely or textbook or repeating"
)
_TOUCHES = ("-k", "not (world_reports or closing_speed or often] or bystander or hundred or last)")
_ROADS = ("tests/sim/test_road.py", "tests/sim/test_scenario.py", "tests/sim/test_world_roads.py")
TARGETS = (
    Target("skd_evaluator.measure.distances.frechet", _FRECHET, ("-k", f"not ({_KERNELS_ONLY})")),
    Target("skd_evaluator.measure.distances.frechet_kernels", _FRECHET, _SMALL_CURVES),
    Target("skd_evaluator.measure.distances.deformation", (_evaluator("deformation"),)),
    Target("skd_evaluator.measure.mean_deformation", (_evaluator("mean_deformation"),)),
    Target("skd_evaluator.measure.skd", (_evaluator("skd"),)),
    Target(
        "skd_evaluator.measure.statistics.statistics",
        (_evaluator("statistics"), _evaluator("skd")),
    ),
    Target("skd_evaluator.measure.statistics.clustered", (_evaluator("clustered"), _evaluator("prior"))),
    Target(
        "skd_evaluator.measure.statistics.clustered_rate",
        (_evaluator("clustered"), _evaluator("statistics")),
    ),
    Target("skd_evaluator.measure.statistics.prior", (_evaluator("prior"), _evaluator("clustered"))),
    Target("skd_evaluator.measure.statistics.difference", (_evaluator("difference"),)),
    Target(
        "skd_evaluator.measure.statistics.sequential",
        (_evaluator("sequential"), _evaluator("fusion_statistics")),
    ),
    Target("skd_evaluator.measure.statistics.sample_size", (_evaluator("sample_size"),)),
    Target("skd_evaluator.measure.equivalent_multiplier", (_evaluator("equivalent_multiplier"),)),
    Target("skd_evaluator.measure.margin_figures", (_evaluator("margin_figures"),)),
    Target("skd_evaluator.measure.vulnerability_curve", (_evaluator("vulnerability_curve"),)),
    Target("skd_evaluator.assessing.otherwise", (_evaluator("otherwise"),)),
    Target("skd_evaluator.assessing.again_graph", (_evaluator("again_graph"),)),
    Target(
        "skd_evaluator.campaign.judge.alone",
        (_evaluator("standing_off"), _evaluator("alone")),
        ("-k", "not drive_in_every"),
    ),
    Target("skd_evaluator.measure.contact_place", (_evaluator("risk_touches"),), _TOUCHES),
    Target("skd_evaluator.risk.touching", (_evaluator("touching"),)),
    Target("skd_evaluator.ncap.points", (_evaluator("ncap_calculator"),)),
    Target("skd_evaluator.ncap.colours", (_evaluator("ncap_calculator"),)),
    Target("skd_evaluator.ncap.matrices", (_evaluator("ncap_calculator"),)),
    Target("skd_sim.geometry.contact", ("tests/sim/test_geometry.py", "tests/sim/test_world_roads.py")),
    Target("skd_sim.geometry.heading", ("tests/sim/test_heading.py",)),
    Target("skd_sim.encounter.road", _ROADS),
    Target("skd_sim.encounter.road_user", ("tests/sim/test_scenario.py", "tests/sim/test_world_roads.py")),
    Target("skd_sim.encounter.ending", ("tests/sim/test_episode.py",)),
    Target("skd_adversary.planning.belief", ("tests/adversary/test_belief.py",)),
    Target("skd_adversary.planning.search_tree", _PLANNER, _QUICK_PLANNING),
    Target("skd_adversary.planning.search", _PLANNER[1:], _QUICK_PLANNING),
    Target("skd_adversary.planning.observation_cells", _PLANNER, _QUICK_PLANNING),
    Target("skd_adversary.planning.ucb", _PLANNER[1:], _QUICK_PLANNING),
    Target("skd_adversary.planning.legality", _PLANNER[1:], _QUICK_PLANNING),
    Target("skd_adversary.planning.rollouts", _PLANNER[1:], _QUICK_PLANNING),
    Target("skd_adversary.planning.learning_rollouts", _ROLLOUTS, _LEARNING),
    Target("skd_adversary.planning.tree_planner", _ROOT, _ROOT_ONLY),
    Target("skd_adversary.planning.planner", _PLANNER[1:], _QUICK_PLANNING),
)
_PYTEST = ("-x", "-q", "--tb=no", "-p", "no:cacheprovider", "-p", "no:xdist", "--hypothesis-profile=mutants")
_IMPORTED = (
    "numpy", "numba", "scipy.stats", "scipy.signal", "hypothesis", "hypothesis.extra.numpy", "shapely", "yaml",
    "similaritymeasures", "_pytest.assertion.rewrite",
)  # fmt: skip
# The examples are those of every run (tests/conftest.py); which smaller one fails too is of no interest here.
settings.register_profile(
    "mutants",
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow],
    derandomize=True,
    database=None,
    phases=[Phase.explicit, Phase.generate],
)


@dataclass(frozen=True)
class Mutant:
    """A module's source with one fault in it."""

    operator: str
    original: str
    source: str

    @property
    def difference(self) -> str:
        """The lines that differ."""
        lines = difflib.unified_diff(self.original.splitlines(), self.source.splitlines(), n=0, lineterm="")
        return "\n".join(line for line in lines if not line.startswith(("---", "+++")))


def mutants_of(source: str) -> list[Mutant]:
    """Return every mutant of a module, each source once."""
    from cosmic_ray.ast import ast_nodes, get_ast  # an extra of its own, which the test of this tool has not
    from cosmic_ray.mutating import mutate_code
    from cosmic_ray.plugins import get_operator, operator_names

    found: dict[str, Mutant] = {}
    # Cosmic Ray parses anew for each mutant: a function on its own takes less time than its module.
    statements = get_ast(source).children
    codes = [statement.get_code() for statement in statements]
    for name in operator_names():
        if not _USED.match(name):
            continue
        operator = get_operator(name)()
        for place, statement in enumerate(statements):
            count = sum(sum(1 for _ in operator.mutation_positions(node)) for node in ast_nodes(statement))
            for occurrence in range(count):
                code = mutate_code(codes[place], operator, occurrence)
                if code is None or code == codes[place]:
                    continue
                mutated = "".join([*codes[:place], code, *codes[place + 1 :]])
                if _is_python(mutated):
                    found.setdefault(mutated, Mutant(name.removeprefix("core/"), source, mutated))
    return list(found.values())


def _is_python(source: str) -> bool:
    """Return whether source can be compiled: the star of a signature is no multiplication."""
    try:
        compile(source, "mutant", "exec")
    except SyntaxError:
        return False
    return True


class QuickestFirst:
    """A plugin of pytest: what took little time in the first run comes first in all others, to notice a fault soon."""

    def __init__(self, times: Path) -> None:
        """Keep the times of the first run in a file, for it is a process of its own."""
        self._times = times
        self._took: Counter[str] = Counter()

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Sort the tests, if their times are known."""
        if self._times.exists():
            known = json.loads(self._times.read_text())
            items.sort(key=lambda item: known.get(item.nodeid, 0.0))

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Add up what a test takes."""
        self._took[report.nodeid] += report.duration

    def pytest_sessionfinish(self) -> None:
        """Write down what the tests took, if nobody has."""
        if not self._times.exists():
            self._times.write_text(json.dumps(self._took))


def outcome_of(target: Target, source: str, limit: float, order: QuickestFirst) -> tuple[str, float]:
    """Return what the tests say of a module with this source: `killed`, `survived` or `timeout`, and the time it took.

    Times are of the processor, s: how busy the machine is must not matter.
    """
    child = os.fork()
    if child == 0:
        try:
            os._exit(_judge(target, source, limit, order))
        except BaseException:
            os._exit(99)
    _, status, used = os.wait4(child, 0)
    code = os.waitstatus_to_exitcode(status)
    if code == _NOT_LOADED:
        raise RuntimeError(f"{target.module}: its mutant was not loaded, so no test could notice it")
    if code in (-signal.SIGXCPU, -signal.SIGALRM):
        return "timeout", limit
    return ("survived" if code == 0 else "killed"), used.ru_utime + used.ru_stime


def _judge(target: Target, source: str, limit: float, order: QuickestFirst) -> int:
    """Run the tests with another source of the module; in a process of its own."""
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    signal.alarm(1800)  # for one that waits for ever
    seconds = int(limit) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    loader = importlib.machinery.SourceFileLoader
    get_code = loader.get_code
    loaded = []

    def instead(self: importlib.machinery.SourceFileLoader, fullname: str) -> CodeType | None:
        if fullname == target.module:
            loaded.append(fullname)
            return compile(source, str(target.path), "exec")
        return get_code(self, fullname)

    loader.get_code = instead  # type: ignore[method-assign]
    # Before pytest is there: SKD has a plug-in of its, and of packages with plug-ins pytest loads all modules itself.
    try:
        importlib.import_module(target.module)
    except Exception:
        if loaded:
            return 1  # and pytest would load the module as it is
    if not loaded:
        return _NOT_LOADED
    return int(pytest.main([*_PYTEST, *target.options, *target.tests], plugins=[order]))


def _run(target: Target, sample: int | None, out: Path, order: QuickestFirst) -> bool:
    """Run the mutants of one module; return whether its tests pass without any."""
    source = target.path.read_text(encoding="utf-8")
    outcome, seconds = outcome_of(target, source, 600.0, order)
    # Once more, in the order that all others have: a test that leans on an earlier one would seem to notice everything.
    if outcome != "survived" or outcome_of(target, source, 600.0, order)[0] != "survived":
        print(f"{target.module}: the tests fail without any mutation", file=sys.stderr)
        return False
    limit = 2.0 + 3.0 * seconds
    mutants = mutants_of(source)
    total = len(mutants)
    if sample is not None and sample < total:
        mutants = random.Random(0).sample(mutants, sample)
    outcomes: Counter[str] = Counter()
    with out.open("a", encoding="utf-8") as file:
        for mutant in mutants:
            outcome, _ = outcome_of(target, mutant.source, limit, order)
            outcomes[outcome] += 1
            line = {"module": target.module, "operator": mutant.operator, "outcome": outcome}
            file.write(json.dumps({**line, "difference": mutant.difference}, ensure_ascii=False) + "\n")
            file.flush()
    noticed = 1.0 - outcomes["survived"] / len(mutants)
    counts = ", ".join(f"{number} {name}" for name, number in sorted(outcomes.items()))
    print(
        f"{target.module}: {100 * noticed:.1f} % of {len(mutants)} of {total} mutants noticed ({counts})",
        flush=True,
    )
    return True


def main() -> int:
    """Run mutants and write down what became of each."""
    parser = argparse.ArgumentParser(description="Which small faults in the measure and the planner do tests notice?")
    parser.add_argument("modules", nargs="*", metavar="MODULE", help="all by default")
    parser.add_argument("--sample", type=int, metavar="N", help="N mutants of each module, drawn with a fixed seed")
    parser.add_argument("--out", type=Path, default=Path("mutants.jsonl"), help="a line per mutant (mutants.jsonl)")
    arguments = parser.parse_args()
    if os.environ.get("NUMBA_DISABLE_JIT") != "1":
        parser.error("run it by scripts/mutants, which has kernels run as plain Python")
    known = [target.module for target in TARGETS]
    if unknown := [name for name in arguments.modules if name not in known]:
        parser.error(f"{unknown[0]} is no module that mutants are made of; these are: {', '.join(known)}")
    os.chdir(ROOT)
    for name in _IMPORTED:
        importlib.import_module(name)
    chosen = [target for target in TARGETS if not arguments.modules or target.module in arguments.modules]
    with tempfile.TemporaryDirectory() as folder:
        for target in chosen:
            if not _run(target, arguments.sample, arguments.out, QuickestFirst(Path(folder) / target.module)):
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""`skd bisect`: the commit that made a car worse."""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

from skd_sim.errors import AssessmentError, UsageError

from skd_evaluator.assessment.options import OWN
from skd_evaluator.cli.arguments import Parser, result_folder, runner_of
from skd_evaluator.cli.output import finish, say

if TYPE_CHECKING:
    from skd_sim.world.state import Trajectory

    from skd_evaluator.assessment.context import Progress
    from skd_evaluator.assessment.plan import Plan
    from skd_evaluator.assessment.run.workers import Workers
    from skd_evaluator.cli.explain import Explanation
    from skd_evaluator.cli.revisions import Repository
    from skd_evaluator.margin.paired_test import Judgement, PairedTest, Version

_DEFAULTS = ("--safe-count", "128", "--adversary-model", "generic")
_EXIT_CODES = {"good": 0, "bad": 1, "skip": 125}
EXIT_ABORT = 128
"""Ends `git bisect run`."""


def add(parser: Parser) -> None:
    """Find the commit that made a car worse, by a paired sequential test on the same trials.

    Find the first commit between GOOD and BAD that made a car worse, and the smallest trial that shows it. After --
    follow options of skd assess: --controller, --scenario, --safe, --safe-count (how many trials there are, by default
    128) or --seed. Each revision is tested on the same trials until it is known to be worse than GOOD or better than
    BAD. All verdicts together are wrong with a probability of at most 5 %. Your own working tree stays as it is.
    """
    parser.set_defaults(group="compare and gate", words=[])
    parser.add_argument("good", metavar="GOOD", help="a git revision of which the car is good")
    parser.add_argument("bad", metavar="BAD", help="a later one of which it is worse")
    text = "judge the commit that is checked out, for git bisect run: exit code 0 good, 1 bad, 125 not known"
    parser.add_flag("--here", text)
    parser.add_workers()
    parser.add_output()


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    from skd_evaluator.report.progress import progress_bar

    with progress_bar(quiet=arguments.quiet) as progress:
        if not arguments.here:
            return _bisect(arguments, progress)
        try:
            with _opened(arguments, progress) as bisection:
                commit = bisection.repository.commit("HEAD")
                found = bisection.judge(commit)
        except (UsageError, AssessmentError, SystemExit) as error:
            say("bisect", f"error: {error}")
            return EXIT_ABORT
    print(f"{bisection.repository.subject(commit)}: {found.word}, {found.why}")
    return _EXIT_CODES[found.word]


def _bisect(arguments: argparse.Namespace, progress: Progress) -> int:
    from skd_evaluator.assessment.files.result_folder import write_json

    out = result_folder(arguments)
    rows: list[dict[str, str]] = []
    with _opened(arguments, progress) as one:

        def judge(commit: str) -> str:
            found = one.judge(commit)
            rows.append({"commit": commit, "verdict": found.word, "why": found.why})
            say("bisect", f"{one.repository.subject(commit)}: {found.word}, {found.why}")
            return found.word

        found = one.repository.bisect(one.good, one.bad, one.folder, judge)
        subjects = [one.repository.subject(commit) for commit in found]
        explanation = one.explanation(found[0]) if len(found) == 1 else None
    content = {
        "good": one.good,
        "bad": one.bad,
        "first_bad": found[0] if len(found) == 1 else None,
        "candidates": found,
        "tested": rows,
        "only_one_hits": explanation and explanation.as_dict(),
    }

    def write(folder: Path) -> None:
        write_json(folder / "bisect.json", content)
        if explanation is not None:
            explanation.write(folder)

    problem = out.save(write)

    def show() -> None:
        print("first bad commit:" if len(found) == 1 else "one of these:", "\n".join(subjects))
        if explanation is not None:
            print(explanation.text)
        print(f"results in {out.path}")
        if explanation is not None:
            print(explanation.command(out.path))

    failed = None if len(found) == 1 else f"{len(found)} commits may be the first bad one, for some cannot be judged"
    return finish(arguments, content, show, (), [problem, failed])


@dataclass
class _Bisection:
    """What the command works with.

    Attributes:
        repository: of the controller.
        plan: of all versions, with the controller as the user has named it.
        good: the good commit.
        bad: the bad commit.
        folder: for worktrees.
        safe: φ of each trial.
        runner: has been started.
        test: judges versions.
    """

    repository: Repository
    request: argparse.Namespace
    plan: Plan
    good: str
    bad: str
    folder: Path
    safe: Sequence[Trajectory]
    runner: Workers

    test: PairedTest = field(init=False)

    def version(self, commit: str) -> Version:
        """Return the car of a commit.

        Raises:
            UsageError: it cannot be loaded.
            AssessmentError: it fails, or hardly drives.
        """
        from skd_evaluator.assessment.from_options import check_car
        from skd_evaluator.assessment.stages.checks import driving
        from skd_evaluator.margin.paired_test import Version
        from skd_evaluator.metrics.aborted import not_credible

        controller = self.repository.controller_at(commit, self.folder)
        scenario = check_car({**vars(self.request), "controller": controller}, self.plan.scenario, graph=False)
        plan = replace(self.plan, controller=controller, scenario=scenario)
        for line in not_credible(driving(plan, self.runner)):
            raise AssessmentError(line)
        return Version(commit[:10], self.repository.content(commit), plan, self.safe)

    def judge(self, commit: str) -> Judgement:
        """Return whether the car of a commit is bad."""
        return self.test.verdict(self.repository.content(commit), lambda: self.version(commit))

    def explanation(self, commit: str) -> Explanation | None:
        """Return the smallest trial that tells the car of a commit from that of its parent; None: one fails."""
        from skd_evaluator.cli.explain import Explanation

        with suppress(UsageError, AssessmentError):
            worse, before = map(self.version, (commit, self.repository.commit(f"{commit}^")))
            trial = self.test.distinguishing_trial(worse, before)
            return Explanation(worse.name, before.name, trial, self.plan.controller)
        return None


@contextmanager
def _opened(arguments: argparse.Namespace, progress: Progress) -> Iterator[_Bisection]:
    """Yield what judges revisions, once the bad one is shown to be worse than the good one.

    Raises:
        UsageError: it is not, or a revision or an option is wrong.
        AssessmentError: one of the two fails.
    """
    from skd_evaluator.assessment.files.episode_store import digest_of
    from skd_evaluator.assessment.from_options import plan_of, scenario_for
    from skd_evaluator.assessment.stages.margin import warm_up_margins
    from skd_evaluator.assessment.stages.safe_trajectories import safe_trajectories
    from skd_evaluator.cli.revisions import Repository, assess_request
    from skd_evaluator.margin.paired_test import PairedTest, level_of
    from skd_evaluator.provenance import environment

    request = assess_request(arguments.words, _DEFAULTS)
    if request.safe == OWN:
        raise UsageError(f"--safe {OWN}: the trials have to be the same for all revisions; give another source")
    repository = Repository(request.controller)
    plan = plan_of(vars(request), scenario_for(request.scenario, request.safe))
    good, bad = map(repository.commit, (arguments.good, arguments.bad))
    contents = [repository.content(one) for one in (good, bad)]
    if contents[0] == contents[1]:
        raise UsageError(f"{arguments.good} and {arguments.bad} have the same files")
    level = level_of(int(repository.git("rev-list", "--count", f"{good}..{bad}")))
    key = digest_of([dict(environment()), repr(plan), contents, level])
    file = repository.storage / "skd-bisect" / f"{key.hex()}.json"
    with repository.checkouts() as folder, runner_of(arguments, isolated=True) as runner:
        runner.start(inherited=warm_up_margins)
        safe = safe_trajectories(plan, runner, progress)
        found = _Bisection(repository, request, plan, good, bad, folder, safe, runner)
        test = found.test = PairedTest(found.version(good), found.version(bad), runner, level, progress)
        test.read(file)
        try:
            test.check_ends()
            yield found
        finally:
            file.parent.mkdir(exist_ok=True)
            test.write(file)

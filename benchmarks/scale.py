"""What it costs to spread a campaign: workers of this machine, a Dask cluster on it, memory, and what is left for one.

The same kamikaze episodes run in one process, in two workers and on a Dask cluster of two workers, in turns; all
results are compared to the bit. What is not the workers' is measured by itself: what a task costs that does nothing,
what an episode costs the process of the campaign and the scheduler, what it takes to judge it, and the memory of the
campaign's process while 10,000 episodes run. From these follows what a million episodes take (docs/scale.md). What one
episode costs the campaign's process and the scheduler is measured with replays, which take the workers next to no time.
What a start takes counts as well: scheduler and worker processes, until each has run its first episodes.

    python benchmarks/scale.py [--episodes N] [--turns N] [--tasks N] [--memory-episodes N] [--json]

Ratios mean something only where nothing else runs and each worker has a core of its own.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import psutil
from local_dask import LocalCluster, local_cluster
from skd_evaluator.assessing.pipeline import planners_of
from skd_evaluator.campaign.judge.assessment import judge
from skd_evaluator.campaign.judge.rating import judge_all
from skd_evaluator.campaign.plan.plan import Plan, kamikaze_set, safe_trajectories, split_episode_id
from skd_evaluator.campaign.run.executor_runner import ExecutorRunner
from skd_evaluator.campaign.run.executors import make_runner
from skd_evaluator.campaign.run.workers import InProcessRunner, available_workers
from skd_evaluator.campaign.store.results import write_assessment
from skd_sim.choices.objective import Objective
from skd_sim.encounter.scenario import load_scenario
from skd_sim.episode.episode import Episode, EpisodeLog, Mode
from skd_sim.geometry.trajectory import Trajectory

ONE, TWO, CLUSTER = "one process", "2 workers", "Dask, 2 workers"
_MACHINES, _MILLION = 100, 1_000_000
_PLACES = ((TWO, 1, 2), (TWO, 1, 32), (CLUSTER, _MACHINES, 2), (CLUSTER, _MACHINES, 32))  # machines, cores of each
_CHUNKS = 4  # a worker has at least so many


def _episodes(plan: Plan, safe: Sequence[Trajectory], count: int) -> list[Episode]:
    return [
        plan.episode(Mode.KAMIKAZE, number % len(safe), number // len(safe), safe[number % len(safe)])
        for number in range(count)
    ]


def _digest(logs: Sequence[EpisodeLog]) -> str:
    digest = hashlib.sha256()
    for log in logs:
        digest.update(log.adversary.tobytes() + log.car.tobytes())
        digest.update(f"{log.episode.episode_id} {log.outcome} {log.impact_time!r} {log.reason}".encode())
    return digest.hexdigest()


@dataclass
class _Turn:
    """Seconds of the wall clock, and of this process with its threads; and the digest of the results."""

    wall: float
    parent: float
    digest: str


def _processor(process: psutil.Process | None) -> float:
    if process is None:
        return 0.0
    times = process.cpu_times()
    return float(times.user + times.system)


def _run(runner: ExecutorRunner, episodes: Sequence[Episode]) -> _Turn:
    of_parent, begin = time.process_time(), time.perf_counter()
    logs = list(runner.run(episodes))
    wall, parent = time.perf_counter() - begin, time.process_time() - of_parent
    return _Turn(wall, parent, _digest(logs))


def _summary(values: Sequence[float]) -> dict[str, float]:
    return {"median": statistics.median(values), "least": min(values), "most": max(values)}


def measure_turns(runners: dict[str, ExecutorRunner], episodes: Sequence[Episode], count: int) -> dict[str, Any]:
    """Run the same episodes everywhere, in turns whose order is reversed each time; see what is faster, and by what."""
    turns: dict[str, list[_Turn]] = {name: [] for name in runners}
    for turn in range(count):
        names = list(runners) if turn % 2 == 0 else list(reversed(runners))
        for name in names:
            turns[name].append(_run(runners[name], episodes))
    digests = {one.digest for each in turns.values() for one in each}
    rows = {
        name: {
            "episodes_per_s": _summary([len(episodes) / one.wall for one in each]),
            "times_one_process": _summary([one.wall / mine.wall for one, mine in zip(turns[ONE], each, strict=True)]),
        }
        for name, each in turns.items()
    }
    return {"episodes": len(episodes), "turns": count, "identical": len(digests) == 1, "runners": rows}


def measure_handling(runner: ExecutorRunner, plan: Plan, phi: Trajectory) -> float:
    """Return what an episode costs the process of the campaign, s; tasks are so few that theirs hardly count."""
    episodes = [plan.episode(Mode.REPLAY, 0, run, phi) for run in range(4000)]
    list(runner.run(episodes[:400]))
    return _run(runner, episodes).parent / len(episodes)


def measure_tasks(runner: ExecutorRunner, scheduler: psutil.Process | None, count: int) -> dict[str, float]:
    """Return what a task costs that does nothing, s: on the wall clock, with workers always busy, and by who pays."""
    runner.pace, pace = runner.pace.__class__(0.0, 0.0), runner.pace  # one item a task
    try:
        list(runner.map(abs, range(count // 4)))
        of_scheduler, of_parent, begin = _processor(scheduler), time.process_time(), time.perf_counter()
        list(runner.map(abs, range(count)))
        wall, parent = time.perf_counter() - begin, time.process_time() - of_parent
    finally:
        runner.pace = pace
    return {
        "wall_s": wall / count,
        "parent_s": parent / count,
        "scheduler_s": (_processor(scheduler) - of_scheduler) / count,
        "task_s": pace.target,
        "idle_s": 2 * wall / count,  # of each of two workers
        "share": 2 * wall / count / (2 * wall / count + pace.target),
    }


class _Memory:
    """Samples the memory of this process while something is done."""

    def __init__(self, done: Callable[[], int]) -> None:
        self._done, self._over = done, threading.Event()
        self._process = psutil.Process()
        self.samples: list[tuple[int, float]] = []
        self._thread = threading.Thread(target=self._watch, daemon=True)

    def _take(self) -> None:
        self.samples.append((self._done(), self._process.memory_info().rss / 2**20))

    def _watch(self) -> None:
        while not self._over.wait(0.2):
            self._take()

    def __enter__(self) -> _Memory:
        self._take()
        self._thread.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._over.set()
        self._thread.join()
        self._take()


def measure_memory(runner: ExecutorRunner, plan: Plan, safe: Sequence[Trajectory], count: int) -> dict[str, Any]:
    """Run, judge and write an assessment of many episodes, all logs of which are held; watch this process's memory."""
    episodes = _episodes(plan, safe, count)
    logs: list[EpisodeLog] = []
    begin = time.perf_counter()
    with _Memory(lambda: len(logs)) as memory:
        for log in runner.run(episodes):
            logs.append(log)
        ran = time.perf_counter() - begin
        tried: list[list[EpisodeLog]] = [[] for _ in safe]
        for log in logs:
            tried[split_episode_id(log.episode.episode_id)[1]].append(log)
        sets = [kamikaze_set(phi, mine) for phi, mine in zip(safe, tried, strict=True)]
        begin = time.process_time()
        judge(plan, safe, sets, (), 0.0)
        judged = time.process_time() - begin
        with tempfile.TemporaryDirectory() as folder:
            rating = judge_all(plan, safe, {Objective.DEFORMATION: sets}, (), 0.0)
            begin = time.process_time()
            write_assessment(Path(folder), rating)
            written = time.process_time() - begin
            size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
    running = memory.samples
    marks = []
    for share in (0.0, 0.25, 0.5, 0.75, 1.0):
        marks.append(next(rss for done, rss in running if done >= share * count))
    return {
        "episodes": count,
        "seconds": ran,
        "judge_s_per_episode": judged / count,
        "write_s_per_episode": written / count,
        "bytes_per_episode": size / count,
        "rss_mib": marks,
        "rss_most_mib": max(rss for _, rss in running),
        "rss_growth_mib_per_1000": (marks[-1] - marks[1]) / (0.75 * count) * 1000,
    }


def extrapolate(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Return what a million episodes take: the workers' time, and what one process has to do for all of them.

    Work of the workers, of the campaign's process and of the scheduler goes on at once: the slowest sets the pace.
    """
    rows = []
    busy = 1.0 / found["turns"]["runners"][ONE]["episodes_per_s"]["median"]
    judge, write = (_MILLION * found["memory"][f"{name}_s_per_episode"] for name in ("judge", "write"))
    for name, machines, cores in _PLACES:
        task, places = found["tasks"][name], machines * cores
        tasks = max(_MILLION * busy / task["task_s"], _CHUNKS * places)
        workers = (_MILLION * busy + tasks * task["idle_s"]) / places
        parent = _MILLION * found["handling_s"][name] + tasks * task["parent_s"]
        scheduler = tasks * task["scheduler_s"]
        rows.append(
            {
                "where": f"{machines} machine{'s' * (machines > 1)}, {cores} cores{' each' * (machines > 1)}",
                "workers_s": workers,
                "parent_s": parent,
                "scheduler_s": scheduler,
                "judge_s": judge,
                "write_s": write,
                "start_s": found["start_s"][name],
                "total_s": found["start_s"][name] + max(workers, parent, scheduler) + judge + write,
            }
        )
    return rows


def measure_start(runner: ExecutorRunner, begin: Callable[[], None], episodes: Sequence[Episode]) -> float:
    """Return how long workers take to start and to run their first episodes, s; their kernels have been compiled."""
    started = time.perf_counter()
    begin()
    list(runner.run(episodes))
    return time.perf_counter() - started


def measure(arguments: argparse.Namespace, cluster: LocalCluster, cluster_start: float) -> dict[str, Any]:
    """Measure everything; a cluster's scheduler and workers took `cluster_start` seconds to come up."""
    plan = Plan(load_scenario("crossing"), safe_count=5, objective=Objective.DEFORMATION)
    warm_up = planners_of(plan, [Objective.DEFORMATION])
    scheduler = psutil.Process(cluster.scheduler.pid)
    with InProcessRunner(1) as one, make_runner(None, 2) as two, make_runner(cluster.address, 2) as dask:
        one.start(warm_up)
        safe = safe_trajectories(plan, one)
        warm = _episodes(plan, safe, 40)
        list(one.run(warm))  # compiles what has not been compiled yet
        found: dict[str, Any] = {"cores": available_workers(), "load_before": list(psutil.getloadavg())}
        found["start_s"] = {
            TWO: measure_start(two, two.start, warm),
            CLUSTER: cluster_start + measure_start(dask, lambda: dask.start(warm_up), warm),
        }
        episodes = _episodes(plan, safe, arguments.episodes)
        found["turns"] = measure_turns({ONE: one, TWO: two, CLUSTER: dask}, episodes, arguments.turns)
        found["tasks"] = {
            TWO: measure_tasks(two, None, 4 * arguments.tasks),
            CLUSTER: measure_tasks(dask, scheduler, arguments.tasks),
        }
        found["handling_s"] = {
            name: measure_handling(one, plan, safe[0]) for name, one in ((TWO, two), (CLUSTER, dask))
        }
        found["memory"] = measure_memory(two, plan, safe, arguments.memory_episodes)
    found["million"] = extrapolate(found)
    return found


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.1f} h"


def _print(found: dict[str, Any]) -> None:
    turns, memory = found["turns"], found["memory"]
    print(f"{found['cores']} cores, load before {found['load_before'][0]:.2f}")
    print(f"\n{turns['episodes']} kamikaze episodes, {turns['turns']} turns: median [least, most]")
    print(f"{'':18}{'episodes/s':>22}{'times one process':>24}")
    for name, row in turns["runners"].items():
        rate, ratio = row["episodes_per_s"], row["times_one_process"]
        print(
            f"{name:18}{rate['median']:8.1f} [{rate['least']:5.1f}, {rate['most']:5.1f}]"
            f"{ratio['median']:10.2f} [{ratio['least']:.2f}, {ratio['most']:.2f}]"
        )
    print(f"results of all identical to the bit: {'yes' if turns['identical'] else 'NO'}")
    print("\nA task that does nothing, ms; share: of a full task's time that is lost between tasks")
    print(f"{'':18}{'wall':>8}{'parent':>8}{'scheduler':>11}{'full task, s':>14}{'share':>8}")
    for name, task in found["tasks"].items():
        print(
            f"{name:18}{1e3 * task['wall_s']:8.2f}{1e3 * task['parent_s']:8.2f}{1e3 * task['scheduler_s']:11.2f}"
            f"{task['task_s']:14.2f}{100 * task['share']:6.1f} %"
        )
    for name, seconds in found["handling_s"].items():
        print(f"{name}: an episode costs the process of the campaign {1e3 * seconds:.3f} ms")
    marks = " ".join(f"{mark:.0f}" for mark in memory["rss_mib"])
    print(
        f"\n{memory['episodes']} episodes, all logs held: {memory['seconds']:.0f} s; this process at 0, 25, 50, 75,"
        f" 100 % of them {marks} MiB, at most {memory['rss_most_mib']:.0f} MiB (judging and writing too); grows by"
        f" {memory['rss_growth_mib_per_1000']:.1f} MiB for 1000 episodes"
    )
    print(
        f"an episode: judged in {1e3 * memory['judge_s_per_episode']:.2f} ms, written in"
        f" {1e3 * memory['write_s_per_episode']:.2f} ms, {memory['bytes_per_episode'] / 1e3:.1f} kB on disk"
    )
    print("\nA million episodes, from these figures")
    print(f"{'':34}{'start':>8}{'workers':>10}{'parent':>10}{'scheduler':>10}{'judge':>10}{'write':>10}{'in all':>10}")
    for row in found["million"]:
        times = [row[f"{name}_s"] for name in ("workers", "parent", "scheduler", "judge", "write", "total")]
        print(
            f"{row['where']:34}{_duration(row['start_s']):>8}"
            + "".join(f"{_duration(seconds):>10}" for seconds in times)
        )


def main() -> int:
    """Measure, and print what was found; return 1 where results differ."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=1000, metavar="N", help="of each turn (default 1000)")
    parser.add_argument("--turns", type=int, default=5, metavar="N", help="of each runner (default 5)")
    parser.add_argument("--tasks", type=int, default=500, metavar="N", help="empty tasks on Dask (default 500)")
    parser.add_argument(
        "--memory-episodes", type=int, default=10_000, metavar="N", help="while memory is watched (default 10000)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON")
    arguments = parser.parse_args()
    begin = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder, local_cluster(2, Path(folder)) as cluster:
        found = measure(arguments, cluster, time.perf_counter() - begin)
    if arguments.json:
        print(json.dumps(found, indent=2))
    else:
        _print(found)
    return 0 if found["turns"]["identical"] else 1


if __name__ == "__main__":
    sys.exit(main())

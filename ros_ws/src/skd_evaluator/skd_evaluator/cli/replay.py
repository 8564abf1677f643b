"""`skd replay`: the assessment from recorded episodes, offline."""

from __future__ import annotations

import argparse
import time

from skd_evaluator.bags.reader import read_episodes
from skd_evaluator.cli.arguments import output_path
from skd_evaluator.cli.assess import print_result
from skd_evaluator.replay import assessment_from
from skd_evaluator.results import ResultFolder
from skd_evaluator.tasks import fill


def run(arguments: argparse.Namespace) -> int:
    """Run the command; return its exit code."""
    begin = time.perf_counter()
    out = ResultFolder(output_path(arguments), overwrite=arguments.overwrite)
    episodes = read_episodes(arguments.paths)
    assessment = assessment_from(
        episodes,
        campaign=arguments.campaign,
        maximum_distance=arguments.max_distance,
        seconds=time.perf_counter() - begin,
    )
    out.write(lambda folder: fill(folder, assessment))
    return print_result(assessment, out.path, begin, "replay", as_json=arguments.json)

"""The commands and their options; light, for it is imported at every start."""

from __future__ import annotations

import argparse
from pathlib import Path

from skd_sim.choices.objective import OBJECTIVES

from skd_evaluator.campaign.plan.options import CampaignOptions
from skd_evaluator.cli.arguments import (
    add_campaign_arguments,
    add_count,
    add_damage_argument,
    add_details_argument,
    add_floor_argument,
    add_graph_arguments,
    add_max_aborted_argument,
    add_options,
    add_output_arguments,
    add_runner_arguments,
    add_verification_arguments,
    add_workers_argument,
    positive_number,
    real_number,
    whole_number,
)
from skd_evaluator.cli.gate import add_gate_arguments

CAR_GROUP = "car and test"


def add_commands(parser: argparse.ArgumentParser, kind: type[argparse.ArgumentParser]) -> None:
    """Add every command to `parser`."""
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=kind)

    assess = commands.add_parser(
        "assess",
        help="margin and SKD of one car",
        description="Compute how far safe trajectories must be bent before this car hits somebody: the margin, which "
        "is a property of the car, and the Safe-Kamikaze Distance of the paper, by kamikazes that plan with what is "
        "known of the car.",
    )
    _add_car(assess, "assess")
    add_graph_arguments(assess, "assess", optional=True)
    add_campaign_arguments(assess, "assess")
    add_gate_arguments(assess)
    add_details_argument(assess)
    assess.add_argument(
        "--curve",
        action="store_true",
        help="also kamikazes that are held to a largest deformation, as points of the vulnerability curve "
        "(vulnerability.png)",
    )
    assess.add_argument(
        "--until-width",
        type=positive_number,
        metavar="W",
        help="go on, --safe-count φ (and --collision-runs along them) at a time, until the interval of the mean "
        "deformation by φ is at most so wide (m), 10 times at most; the intervals allow for the repeated looks",
    )

    sweep = commands.add_parser(
        "sweep",
        help="the paper's table: nine multipliers, synthetic and recorded safe trajectories",
        description="Compute SKD and collision rate for each multiplier C of the basic controller, with synthetic safe "
        "trajectories and, where --safe gives a path, with recorded ones.",
    )
    sweep.add_argument(
        "--safe",
        metavar="PATH",
        help="recorded safe trajectories (CITR vci_lat_uni folder, csv file or folder)",
    )
    sweep.add_argument(
        "--multipliers",
        type=real_number(0.0, 100.0),
        nargs="+",
        metavar="C",
        help="instead of the paper's nine (0.5 … 1.15)",
    )
    add_options(sweep, "sweep", CAR_GROUP)
    add_campaign_arguments(sweep, "sweep")

    campaign = commands.add_parser(
        "campaign",
        help="many assessments from one file: cars, encounters, seeds, sweeps; can be resumed",
        description="Assess many cars, in many encounters, with many seeds and values of any key, all from one YAML "
        "file. Every episode is stored as soon as it is run: whatever ends a campaign, --resume goes on with it.",
    )
    campaign.add_argument("path", type=Path, metavar="FILE", help="what to assess, in YAML (docs/campaigns.md)")
    campaign.add_argument("--resume", action="store_true", help="go on with what is in --out; without any, begin")
    campaign.add_argument("--dry-run", action="store_true", help="only say which assessments, and how many episodes")
    add_runner_arguments(campaign)
    shared = "assessments that share the processes at one time (default: 2, with one process 1, with --scheduler 8)"
    add_count(campaign, "--at-once", 1, 256, shared)
    side_by_side = "so many node graphs side by side, for assessments with graph: true"
    add_count(campaign, "--graphs", 1, 16, side_by_side, default=1)
    add_max_aborted_argument(campaign)
    add_output_arguments(campaign)

    episode = commands.add_parser(
        "episode",
        help="one episode through the node graph, recorded",
        description="Run one episode through the node graph and record it as a bag.",
    )
    _add_car(episode, "episode")
    episode.add_argument(
        "--mode",
        choices=("safe", "kamikaze", "replay"),
        default="kamikaze",
        help="what the adversary does (default kamikaze)",
    )
    episode.add_argument(
        "--attempt", type=whole_number(0), default=0, metavar="N", help="which attempt of the campaign (default 0)"
    )
    # Of a single episode there is one objective, and one φ: that of a campaign with as many.
    single = {"default": str(CampaignOptions.objective), "choices": OBJECTIVES, "metavar": "NAME"}
    add_options(episode, "episode", "campaign", objective=single)
    of_how_many = "how many safe trajectories the campaign has that this is an episode of"
    add_count(episode, "--safe-count", 1, 65_535, of_how_many, default=1)
    add_count(episode, "--safe-number", 0, 65_534, "which of the --safe-count safe trajectories, from 0", default=0)
    add_graph_arguments(episode, "episode", optional=False)
    add_output_arguments(episode)

    replay = commands.add_parser(
        "replay",
        help="offline SKD from MCAP logs",
        description="Compute the assessment from recorded episodes: bag folders, .mcap files, or folders of them, "
        "recorded by the evaluator or by ros2 bag record.",
    )
    replay.add_argument("paths", type=Path, nargs="+", metavar="PATH", help="bag folder, .mcap file or folder of them")
    replay.add_argument("--campaign", metavar="NAME", help="which campaign, where the bags hold several")
    replay.add_argument(
        "--max-distance",
        dest="maximum_distance",
        type=positive_number,
        metavar="M",
        help="discard pairs further apart than this many metres",
    )
    add_max_aborted_argument(replay)
    add_floor_argument(replay)
    add_verification_arguments(replay, "--verify")
    add_damage_argument(replay)
    add_details_argument(replay)
    add_gate_arguments(replay)
    add_output_arguments(replay)

    compare = commands.add_parser(
        "compare",
        help="several assessments side by side, and which of the cars is safer",
        description="Put results of skd assess side by side: their figures in one table, their vulnerability curves in "
        "one picture, in which safer cars lie to the right, and what each car is beside the first: safer, less safe or "
        "not told apart, by the margin, on the same φ where they have the same.",
    )
    compare.add_argument(
        "paths", type=Path, nargs="+", metavar="DIR", help="folder of an assessment; the first is compared with"
    )
    add_output_arguments(compare)

    verify = commands.add_parser(
        "verify",
        help="whether results are what was written, and their figures what their episodes give",
        description="Hold every file of a result against its manifest (manifest.sha256), compute every figure of "
        "assessment.json anew from episodes.npz, and see whether each episode can have happened. Says which agree, "
        "which do not (then the exit code is 1), and which cannot be recomputed from the folder. With --decisions also "
        "what kamikazes decided.",
    )
    verify.add_argument(
        "paths", type=Path, nargs="+", metavar="DIR", help="folder of an assessment, sweep or campaign, or one of these"
    )
    add_verification_arguments(verify, "--decisions")
    verify.add_argument("--json", action="store_true", help="print JSON, which names every figure")

    plan = commands.add_parser(
        "plan",
        help="how many φ and kamikazes a wanted width or power takes",
        description="From how much an earlier result varies between and within safe trajectories φ: how many φ, and "
        "how many kamikazes for each, an interval of a wanted width takes, or a difference that is to be found.",
    )
    plan.add_argument(
        "paths",
        type=Path,
        nargs="*",
        metavar="DIR",
        help="folder of an assessment; two of the same φ for --difference (default: stated variances of the basic car)",
    )
    wanted = plan.add_mutually_exclusive_group(required=True)
    wanted.add_argument(
        "--width", type=positive_number, metavar="W", help="wanted width of the 95 percent interval by φ, m"
    )
    wanted.add_argument(
        "--difference", type=positive_number, metavar="D", help="difference between two cars that is to be found, m"
    )
    plan.add_argument(
        "--power",
        type=real_number(0.06, 0.9999),
        default=0.8,
        metavar="P",
        help="how likely the difference is to be found (default 0.8)",
    )
    plan.add_argument("--unpaired", action="store_true", help="the cars face different φ")
    plan.add_argument(
        "--figure",
        choices=("margin", "deformation", "skd", "collision_rate"),
        default="margin",
        help="of which (default margin); deformation and skd are of planned kamikazes; runs along φ take the place of "
        "attempts for the collision rate",
    )
    add_count(plan, "--kamikaze-count", 2, 1_000_000, "only so many for each φ")
    plan.add_argument("--json", action="store_true", help="print JSON instead of a table")
    report = commands.add_parser(
        "report",
        help="one HTML file of assessments and sweeps: figures, charts, every episode with a player",
        description="Write one self-contained HTML file of results: verdict, figures with their intervals, charts, "
        "maps, and every episode with a player and the command that repeats it. It asks no network for anything.",
    )
    report.add_argument("paths", type=Path, nargs="+", metavar="DIR", help="folder of an assessment, sweep or campaign")
    add_output_arguments(report, "FILE", "the .html file (default: skd_results/report-<time>.html)")

    show = commands.add_parser(
        "show",
        help="the worst episodes of a result, or one of them, as pictures or films",
        description="Draw episodes of a result, the worst for the car first: seen from above, and the distances over "
        "time; with each the command that repeats it.",
    )
    show.add_argument("path", type=Path, metavar="RESULT", help="folder of an assessment")
    which = show.add_mutually_exclusive_group()
    add_count(which, "--worst", 1, 1000, "the N worst, a file each", default=1)
    which.add_argument(
        "--episode", type=whole_number(0), metavar="ID", help="the one with this id, as episodes.npz and bags have it"
    )
    show.add_argument("--objective", metavar="NAME", help="only kamikazes of this objective (default: all episodes)")
    show.add_argument(
        "--format",
        choices=("png", "gif", "mp4"),
        default="png",
        help="picture, or film at half speed; mp4 needs ffmpeg (default png)",
    )
    add_output_arguments(show)

    probe = commands.add_parser(
        "probe",
        help="episodes that show how a car reacts, for fit",
        description="Run varied crossings that show when and how a car brakes, and keep their logs for skd fit: bags "
        "through the node graph, episodes.npz in process.",
    )
    _add_car(probe, "probe")
    add_count(probe, "--episodes", 1, 1_000_000, "how many", default=1000)
    add_options(probe, "probe", "campaign")
    add_workers_argument(probe)
    add_graph_arguments(probe, "probe", optional=True, record=False)
    add_output_arguments(probe)

    fit = commands.add_parser(
        "fit",
        help="the predictive model of a car from logs",
        description="Estimate by maximum likelihood how a car brakes, from recorded episodes: bag folders, .mcap "
        "files, episodes.npz, or folders of them. Writes car_model.yaml.",
    )
    fit.add_argument("paths", type=Path, nargs="+", metavar="PATH", help="bag folder, .mcap or .npz file, or a folder")
    add_damage_argument(fit)
    add_output_arguments(fit)

    completion = commands.add_parser(
        "completion",
        help="completion for your shell",
        description='Print what makes a shell complete commands, options and names: eval "$(skd completion bash)".',
    )
    completion.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="your shell")


def _add_car(parser: argparse.ArgumentParser, command: str) -> None:
    group = parser.add_argument_group(CAR_GROUP)
    add_options(group, command, CAR_GROUP)
    group.add_argument(
        "--scenario",
        metavar="NAME",
        help="shipped or registered scenario, or YAML file (default: crossing; citr_crossing with CITR data)",
    )


class _Version(argparse.Action):
    """Prints the version; the lookup is made only when asked for."""

    def __init__(self, option_strings: list[str], dest: str, **kwargs: object) -> None:
        super().__init__(option_strings, dest, nargs=0, help=str(kwargs.get("help")))

    def __call__(self, parser: argparse.ArgumentParser, *_ignored: object) -> None:
        from skd_evaluator.version import version

        print(f"skd {version()}")
        parser.exit()

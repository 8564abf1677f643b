"""The commands and their options; light, for it is imported at every start."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from skd_sim.options.adversary import OBJECTIVES

from skd_evaluator.assessment.options import AssessmentOptions, CampaignOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    add_campaign_arguments,
    add_car_arguments,
    add_count,
    add_damage_argument,
    add_details_argument,
    add_graph_arguments,
    add_max_aborted_argument,
    add_options,
    add_output_arguments,
    add_pictures_argument,
    add_runner_arguments,
    add_workers_argument,
    positive_number,
    real_number,
    steps_of,
    whole_number,
)
from skd_evaluator.cli.gate import add_gate_arguments

_DEFAULT_FOLDER = Path("skd_results")
_REFERENCE_TRIALS = 10


def add_commands(parser: argparse.ArgumentParser, kind: type[argparse.ArgumentParser]) -> Any:
    """Add SKD's own commands to `parser`, and return argparse's action that holds them."""
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=kind)

    assess = commands.add_parser(
        "assess",
        help="rate one car: its margin and its SKD",
        description="Rate one car. A safe trajectory φ is a way on which an adversary (say, a pedestrian) crosses "
        "unharmed; a kamikaze is an adversary that leaves it in order to be hit. The margin is the least distance "
        "that somebody has to stray from a safe trajectory before the moving car hits them; it is a property of the "
        "car. The Safe-Kamikaze Distance (SKD), the paper's measure, says how far kamikazes stray who plan with what "
        "they know about the car.",
    )
    add_car_arguments(assess, "assess")
    add_graph_arguments(assess, "assess", optional=True)
    add_campaign_arguments(assess, "assess")
    add_gate_arguments(assess)
    add_details_argument(assess)
    add_pictures_argument(
        assess,
        "draw no pictures beside the figures, which saves about a second; skd show and skd report still draw them",
    )
    assess.add_argument(
        "--until-width",
        type=positive_number,
        metavar="W",
        help="add safe trajectories until the 95 %% interval of the planned deviation is at most W metres wide: "
        "--safe-count of them at a time, each time with --collision-runs, and at most 10 times. The intervals allow "
        "for being looked at repeatedly",
    )

    sweep = commands.add_parser(
        "sweep",
        help="the paper's experiment: rate the basic car with nine multipliers C",
        description="Repeat the paper's experiment: compute margin, SKD and contact rate of the basic car with each "
        "multiplier C, on synthetic safe trajectories and, if --safe gives them, on recorded ones or walkers.",
    )
    sweep.add_argument(
        "--safe",
        metavar="SOURCE",
        help="walkers, or where recorded safe trajectories are: the folder of CITR's vci_lat_uni, a csv file with "
        "columns t, x, y, or a folder of such files",
    )
    sweep.add_argument(
        "--multipliers",
        type=real_number(0.0, 100.0),
        nargs="+",
        metavar="C",
        help="rate the basic car with these multipliers C instead of the paper's nine (0.5 to 1.15)",
    )
    add_options(sweep, "sweep", CAR_GROUP)
    add_campaign_arguments(sweep, "sweep")

    episode = commands.add_parser(
        "episode",
        help="run one episode through the node graph and record it",
        description="Run one episode through the node graph and record it as a bag.",
    )
    add_car_arguments(episode, "episode")
    episode.add_argument(
        "--mode",
        choices=("safe", "kamikaze", "replay", "risk"),
        default="kamikaze",
        help="what the adversary does: safe (cross unharmed), kamikaze (be hit), replay (follow a safe trajectory), or "
        "risk (walk a safe trajectory as people do: a crossing of the risk, as --behaviour and --scale say) "
        "(default: kamikaze)",
    )
    add_options(episode, "episode", table=AssessmentOptions)
    episode.add_argument(
        "--scale",
        type=positive_number,
        default=1.0,
        metavar="S",
        help="with --mode risk, by what the deviations of people are multiplied (default: 1)",
    )
    episode.add_argument(
        "--trial",
        type=whole_number(0),
        default=0,
        metavar="N",
        help="which trial of the assessment to repeat, from 0 (default: 0)",
    )
    # Of a single episode there is one objective, and one φ: that of a campaign with as many.
    single = {
        "default": str(CampaignOptions.objective),
        "choices": OBJECTIVES,
        "metavar": "NAME",
        "help": "what the kamikaze is rewarded for: deviation (bending the safe trajectory φ as little as possible), "
        "paper (colliding as soon as possible), or frechet (a small Fréchet distance to φ) (default: %(default)s)",
    }
    add_options(episode, "episode", "campaign", objective=single)
    of_how_many = "how many safe trajectories the assessment has to which this episode belongs"
    add_count(episode, "--safe-count", 1, 65_535, of_how_many, default=1)
    which_one = "which of these safe trajectories the episode is about, from 0"
    add_count(episode, "--safe-number", 0, 65_534, which_one, default=0)
    add_graph_arguments(episode, "episode", optional=False)
    add_output_arguments(episode)

    replay = commands.add_parser(
        "replay",
        help="rate a car from recorded episodes (MCAP logs)",
        description="Rate a car from recorded episodes, offline: from bag folders, .mcap files or folders of them, "
        "recorded by SKD or by ros2 bag record.",
    )
    replay.add_argument(
        "paths", type=Path, nargs="+", metavar="PATH", help="a bag folder, an .mcap file, or a folder of them"
    )
    replay.add_argument("--campaign", metavar="NAME", help="which campaign to rate, if the bags hold several")
    replay.add_argument(
        "--maximum-distance",
        type=positive_number,
        metavar="M",
        help="leave out each kamikaze that ended up further than this many metres from its safe trajectory",
    )
    add_max_aborted_argument(replay)
    add_options(replay, "replay", table=AssessmentOptions)
    add_damage_argument(replay)
    add_details_argument(replay)
    add_gate_arguments(replay)
    add_output_arguments(replay)

    compare = commands.add_parser(
        "compare",
        help="put assessments side by side and say which car is safer",
        description="Put results of skd assess side by side: their figures in one table, and their vulnerability "
        "curves in one picture, in which safer cars lie further right. For each car it says whether it is safer or "
        "less safe than the first, or cannot be told apart from it. That goes by the margin and by the risk: one of "
        "them has to tell the cars apart, and none the other way, and neither margin nor R(2) may point the other "
        "way even by an estimate that is not sure. Cars are compared trajectory by trajectory where both results are "
        "about the same safe trajectories φ.",
    )
    compare.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder of an assessment; the others are compared with the first",
    )
    compare.add_argument(
        "--reference",
        type=Path,
        metavar="DIR",
        help="folder of skd sweep, or of a campaign, whose basic cars are drawn as a curve behind margin and risk. "
        "They have to be over the same safe trajectories, in the same scenario and with the same behaviour model",
    )
    add_pictures_argument(compare, "draw no pictures beside comparison.json, which saves about half a second")
    add_output_arguments(compare)

    verify = commands.add_parser(
        "verify",
        help="check that results are unchanged and follow from their episodes",
        description="Compare every file of a result with its checksum in manifest.sha256, compute every figure of "
        "assessment.json anew from episodes.npz, and check that each episode can have happened. It says what agrees, "
        "what does not (then the exit code is 1), and what cannot be recomputed from the folder.",
    )
    verify.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="DIR",
        help="folder of an assessment, a sweep or a campaign, or a folder of such",
    )
    verify.add_argument("--json", action="store_true", help="print JSON, which names every figure, instead of lines")

    plan = commands.add_parser(
        "plan",
        help="say how many safe trajectories a wanted precision takes",
        description="Say how many safe trajectories φ, and how many kamikazes for each, it takes until an interval is "
        "as narrow as wanted, or until a difference between two cars is found. It goes by how much an earlier result "
        "varies from φ to φ, and between kamikazes of the same φ.",
    )
    plan.add_argument(
        "paths",
        type=Path,
        nargs="*",
        metavar="DIR",
        help="folder of an earlier assessment; for --difference two folders that are about the same φ (default: what "
        "the basic car's figures vary by)",
    )
    wanted = plan.add_mutually_exclusive_group(required=True)
    wanted.add_argument(
        "--width",
        type=positive_number,
        metavar="W",
        help="wanted width of the 95 percent interval, in the figure's unit: m, a share of runs, or m/s²",
    )
    wanted.add_argument(
        "--difference", type=positive_number, metavar="D", help="difference between two cars that has to be found, m"
    )
    plan.add_argument(
        "--power",
        type=real_number(0.06, 0.9999),
        default=0.8,
        metavar="P",
        help="probability with which the difference has to be found (default: 0.8)",
    )
    plan.add_argument("--unpaired", action="store_true", help="the two cars are rated on different safe trajectories")
    plan.add_argument(
        "--figure",
        choices=("margin", "deviation", "skd", "contact_rate"),
        default="margin",
        help="the figure that is asked about: margin, deviation or skd (both of planned kamikazes), or "
        "contact_rate, for which runs along φ are counted instead of kamikazes (default: margin)",
    )
    add_count(plan, "--kamikaze-count", 2, 1_000_000, "say only how many φ it takes with this many kamikazes for each")
    plan.add_argument("--json", action="store_true", help="print JSON instead of a table")
    report = commands.add_parser(
        "report",
        help="write one HTML file: figures, charts, and every episode with a player",
        description="Write results into one HTML file: a verdict, figures with their intervals, charts, maps, and "
        "every episode with a player and the command that repeats it. The file needs no other file and no network.",
    )
    report.add_argument(
        "paths", type=Path, nargs="+", metavar="DIR", help="folder of an assessment, a sweep or a campaign"
    )
    add_output_arguments(report, "FILE", "the HTML file to write (default: skd_results/report-<time>.html)")

    show = commands.add_parser(
        "show",
        help="draw the worst episodes of a result, or one of them, as pictures or films",
        description="Draw episodes of a result, the worst for the car first: as seen from above, with the distances "
        "over time. For each it also prints the command that repeats the episode.",
    )
    show.add_argument("path", type=Path, metavar="RESULT", help="folder of an assessment")
    which = show.add_mutually_exclusive_group()
    add_count(
        which, "--worst", 1, 1000, "how many episodes to draw, each into a file, the worst for the car first", default=1
    )
    which.add_argument(
        "--episode",
        type=whole_number(0),
        metavar="ID",
        help="draw the episode that has this id in episodes.npz and bags",
    )
    likely = (
        "draw so many of the most likely failures of the risk instead: of each kind the nearest to how people walk, "
        "the most frequent kind first, then the next of each"
    )
    add_count(which, "--failures", 1, 1000, likely)
    show.add_argument(
        "--objective", metavar="NAME", help="draw only kamikazes of this objective (default: all episodes)"
    )
    show.add_argument(
        "--format",
        choices=("png", "gif", "mp4"),
        default="png",
        help="png for pictures; gif or mp4 for films at half speed, of which mp4 needs ffmpeg (default: png)",
    )
    add_output_arguments(show)

    scenarios = commands.add_parser(
        "scenarios",
        help="list scenarios, show one, check a file of your own",
        description="list: the scenarios that have a name, which --scenario takes. show: what happens in some of "
        "them, with a picture each. check: the same of files of your own, after all checks that an assessment makes "
        "before any work. campaign: the file of a campaign in which scenarios are run at several test speeds. "
        "reference: the margins of basic cars in scenarios, or in those of assessments, whose cars' equivalent "
        "multiplier then follows.",
    )
    scenarios.add_argument("action", choices=("list", "show", "check", "campaign", "reference"), help="what to do")
    scenarios.add_argument(
        "names",
        nargs="*",
        metavar="NAME",
        help="names or files of scenarios; with reference also folders of assessments",
    )
    scenarios.add_argument(
        "--speeds",
        type=steps_of("km/h", 0.0, 200.0),
        metavar="FROM:TO:STEP",
        help="test speeds of the car, km/h, as 10:60:10; with campaign",
    )
    _add_reference_arguments(scenarios)
    add_output_arguments(
        scenarios,
        "PATH",
        "folder for the pictures (default: skd_results/scenarios-<time>; with list none are made), or with campaign "
        "the file to write (default: standard output)",
    )

    _add_model_commands(commands)
    _add_overview_commands(commands)

    completion = commands.add_parser(
        "completion",
        help="let your shell complete commands and options",
        description="Print shell code that completes commands, options and names when the tab key is pressed. To use "
        'it: eval "$(skd completion bash)", likewise in zsh; in tcsh, skd completion tcsh > FILE and source FILE.',
    )
    completion.add_argument("shell", choices=("bash", "zsh", "tcsh"), help="your shell")
    return commands


class _Version(argparse.Action):
    """Prints the version; the lookup is made only when asked for."""

    def __init__(self, option_strings: list[str], dest: str, **kwargs: object) -> None:
        super().__init__(option_strings, dest, nargs=0, help=str(kwargs.get("help")))

    def __call__(self, parser: argparse.ArgumentParser, *_ignored: object) -> None:
        from skd_evaluator.version import version

        print(f"skd {version()}")
        parser.exit()


def _add_model_commands(commands: Any) -> None:
    probe = commands.add_parser(
        "probe",
        help="run episodes that show how a car reacts, for skd fit",
        description="Run varied crossings that show when and how a car brakes, and keep them for skd fit: with --graph "
        "as bags, otherwise in a file episodes.npz.",
    )
    add_car_arguments(probe, "probe")
    add_count(probe, "--episodes", 1, 1_000_000, "how many episodes to run", default=1000)
    add_options(probe, "probe", "campaign")
    add_workers_argument(probe)
    add_graph_arguments(probe, "probe", optional=True, record=False)
    add_output_arguments(probe)

    fit = commands.add_parser(
        "fit",
        help="learn a model of a car from recorded episodes",
        description="Estimate by maximum likelihood how a car brakes, from recorded episodes, and write the model to "
        "car_model.yaml. skd assess --car-model lets the adversary plan with it.",
    )
    fit.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="PATH",
        help="a bag folder, an .mcap file, an episodes.npz, or a folder of them",
    )
    add_damage_argument(fit)
    add_output_arguments(fit)

    behaviour = commands.add_parser(
        "behaviour",
        help="learn how people deviate from the way they mean to go, for the risk",
        description="Fit a behaviour model to people who were tracked, check it on people whom it has not seen, and "
        "write it to behaviour.yaml. skd assess --behaviour estimates the risk with it.",
    )
    behaviour.add_argument("action", choices=("fit",), help="fit: fit a behaviour model to tracks")
    behaviour.add_argument(
        "paths",
        type=Path,
        nargs="+",
        metavar="PATH",
        help="the folder of CITR's vci_lat_uni, a csv file with columns t, x, y (x along the way that is intended) "
        "or a folder of such files, or recorded episodes, whose safe trajectories are taken",
    )
    behaviour.add_argument(
        "--name", default="fitted", metavar="NAME", help="what the model is called (default: fitted)"
    )
    behaviour.add_argument(
        "--kind", default="pedestrian", metavar="KIND", help="the kind of road user (default: pedestrian)"
    )
    behaviour.add_argument("--description", default="", metavar="TEXT", help="whom the model is of")
    add_damage_argument(behaviour)
    add_output_arguments(behaviour)


def _add_overview_commands(commands: Any) -> None:
    listed = commands.add_parser(
        "list",
        help="list the assessments under a folder",
        description="List the assessments in and under folders, cells of campaigns and sweeps included: car, margin, "
        "date, and the commit of the car's code. Figures are those that are written; a file that is not what was "
        "written is marked.",
    )
    _add_folders(listed)
    _add_car(listed)
    listed.add_argument("--scenario", metavar="TEXT", help="only those whose scenario's name holds this text")
    listed.add_argument(
        "--sort",
        choices=("date", "folder", "car", "margin", "nominal_collision_rate"),
        default="date",
        help="in which order (default: date)",
    )
    add_count(listed, "--last", 1, 1_000_000, "only so many, the last of the order")
    listed.add_argument("--json", action="store_true", help="print JSON instead of a table")

    trend = commands.add_parser(
        "trend",
        help="say how a car has changed from assessment to assessment",
        description="Follow a figure of each car over its assessments in and under folders, in the order of their "
        "dates: each with its interval, and whether the car is safer or less safe than in the one before, judged as "
        "skd compare does. All verdicts of a car together are right with 95 percent.",
    )
    _add_folders(trend)
    _add_car(trend)
    trend.add_argument(
        "--figure",
        choices=("margin", "deviation", "skd", "nominal_collision_rate", "risk_1"),
        default="margin",
        help="the figure that is followed (default: margin)",
    )
    add_pictures_argument(trend, "draw no picture beside trend.json")
    add_output_arguments(trend)

    doctor = commands.add_parser(
        "doctor",
        help="say what is installed, what is missing, and for what",
        description="Look at what SKD needs and at what is optional, say what to do about what is missing, and send a "
        "message between two nodes of ROS 2. Nothing is installed. The exit code is 1 where something does not work.",
    )
    doctor.add_argument(
        "--no-round-trip", dest="round_trip", action="store_false", help="start no nodes: look at files alone"
    )
    doctor.add_argument("--json", action="store_true", help="print JSON instead of lines")

    _add_drive(commands)


def _add_drive(commands: Any) -> None:
    drive = commands.add_parser(
        "drive",
        help="watch a car drive, and step in front of it with the keyboard",
        description="Watch a car drive at the pace of the wall clock, in the terminal: as seen from above, with its "
        "speed, its commands and their age. The adversary goes where your keys send it, or follows a safe trajectory "
        "φ. The options are those of skd assess, so you can see your controller or node work before you rate it. With "
        "--graph, RViz and Foxglove can show the drive, too. Nothing is rated, and only a run that fails leaves "
        "something: its logs. Without a terminal it prints one line a second and ends with the first episode.",
    )
    followed = (
        "let the adversary follow safe trajectories φ instead of the keys: synthetic, own, walkers, regulatory, or a "
        "path, as skd assess takes them (default: it goes by keys)"
    )
    add_car_arguments(drive, "drive", safe={"default": None, "help": followed})
    add_count(drive, "--safe-number", 0, 65_534, "with --safe, by which φ to begin, counted from 0 (default: 0)")
    ticks = "end each episode after at most this many ticks, mostly of 0.3 s (default: as the scenario says)"
    add_count(drive, "--ticks", 1, 100_000, ticks)
    add_options(drive, "drive", "campaign")
    rate = "how many simulated seconds pass in a second of the wall clock; 0.5 is slow motion (default: 1)"
    add_graph_arguments(drive, "drive", optional=True, record=False, rate_factor={"help": rate})
    group = drive.add_argument_group("output")
    group.add_argument("--json", action="store_true", help="print how each episode ended as JSON, and no picture")
    loudness = group.add_mutually_exclusive_group()
    loudness.add_argument("-v", "--verbose", action="store_true", help="report the source of an error")
    loudness.add_argument("-q", "--quiet", action="store_true", help="print only how each episode ended")


def _add_folders(parser: Any) -> None:
    parser.add_argument(
        "paths",
        type=Path,
        nargs="*",
        default=[_DEFAULT_FOLDER],
        metavar="DIR",
        help=f"folder of results, or one above some (default: {_DEFAULT_FOLDER})",
    )


def _add_car(parser: Any) -> None:
    parser.add_argument("--car", metavar="TEXT", help="only cars whose name holds this text")


def _add_reference_arguments(scenarios: argparse.ArgumentParser) -> None:
    """Add the options of `skd scenarios reference`."""
    group = scenarios.add_argument_group("reference")
    group.add_argument(
        "--multipliers",
        type=real_number(0.0, 100.0),
        nargs="+",
        metavar="C",
        help="C of the basic cars (default: 0.5 0.75 1 1.25 1.5)",
    )
    add_count(group, "--trials", 1, 10_000, "trials on each φ of a scenario", default=_REFERENCE_TRIALS)
    add_options(group, "reference", table=AssessmentOptions)
    add_options(group, "reference")
    add_runner_arguments(group)

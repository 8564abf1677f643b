"""The commands, their options, and the parser, whose errors are one line. Light: it is imported at every start."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NoReturn

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.options.adversary import OBJECTIVES
from skd_sim.options.registry import Registry

from skd_evaluator.assessment.options import AssessmentOptions, CampaignOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    add_campaign_arguments,
    add_car_arguments,
    add_count,
    add_damage_argument,
    add_flag,
    add_graph_arguments,
    add_loudness,
    add_max_aborted_argument,
    add_options,
    add_output_arguments,
    add_parameters,
    add_paths,
    add_workers_argument,
    parameters_of,
    positive_number,
    real_number,
    steps_of,
    whole_number,
)
from skd_evaluator.cli.gate import add_gate_arguments

EXIT_USAGE = 2
COMMANDS = "skd.commands"
"""Group of entry points: functions that add a command's parser to what `ArgumentParser.add_subparsers` returns. The
parser's default `module` names the module whose `run` is given the arguments and returns the exit code."""
_DEFAULT_FOLDER = Path("skd_results")
_DETAILS = "print every figure, and a line for each safe trajectory"
_FIGURES = ("margin", "deviation", "skd", "nominal_collision_rate", "risk_1")


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one line."""

    def error(self, message: str) -> NoReturn:
        """Leave with the message."""
        self.exit(EXIT_USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def _print_message(self, message: str, file: Any = None) -> None:
        if message and file is not None and file is sys.stdout:
            file.write(message)  # Python's own drops without a word what the disk does not take
        else:
            super()._print_message(message, file)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            error.message += did_you_mean(str(value), map(str, action.choices or ()))
            raise


def make_parser(words: Sequence[str] = ()) -> Parser:
    """Return the parser of all commands; of SKD's own alone if the first word is one of these, which is quicker."""
    parser = Parser(
        prog="skd",
        description="How safe is a self-driving car's software? Measure how far a pedestrian may deviate from a safe "
        "crossing before the car collides.",
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    for add in (
        _add_assess, _add_sweep, _add_episode, _add_replay, _add_compare, _add_verify, _add_plan, _add_report,
        _add_show, _add_scenarios, _add_probe, _add_fit, _add_list, _add_doctor, _add_drive,
    ):  # fmt: skip
        add(commands)
    if not words or words[0] not in commands.choices:
        registry = Registry("command", COMMANDS, dict.fromkeys(commands.choices, ""))
        for name in registry.registered():
            try:
                registry.find(name)(commands)
            except UsageError as error:  # it cannot be loaded
                commands.add_parser(name, help=str(error)).set_defaults(problem=str(error))
    return parser


def parse(parser: Parser, words: Sequence[str]) -> argparse.Namespace:
    """Return what a command line requests, with the parameters that it names; wrong usage ends the program.

    Raises:
        UsageError: a parameter is wrong.
    """
    arguments, unknown = parser.parse_known_args(words)
    chosen = commands_of(parser)[arguments.command]
    if problem := getattr(arguments, "problem", ""):
        parser.exit(EXIT_USAGE, f"{parser.prog}: error: {problem}\n")
    if strange := next((word for word in words if re.search("[\ud800-\udfff]", word)), ""):
        chosen.error(f"{strange!r} has bytes that are no text in UTF-8; give another name")
    if unknown:
        flags = [flag for action in chosen._actions for flag in action.option_strings]
        given = [word.partition("=")[0] for word in unknown if re.match(r"--\w", word)]
        known = getattr(arguments, "parameters", {})
        if seldom := next((name for flag in given if (name := flag[2:].replace("-", "_")) in known), ""):
            chosen.error(f"unrecognized arguments: {' '.join(unknown)}; give it as -p {seldom}:=VALUE")
        near = next(filter(None, (did_you_mean(flag, flags) for flag in given)), "")
        chosen.error(f"unrecognized arguments: {' '.join(unknown)}{near}")
    if found := parameters_of(arguments):
        chosen.set_defaults(**found)
        arguments = parser.parse_args(words)
    return arguments


def commands_of(parser: argparse.ArgumentParser) -> dict[str, argparse.ArgumentParser]:
    """Return the parser of each command."""
    (found,) = (action for action in parser._actions if isinstance(action, argparse._SubParsersAction))
    return dict(found.choices)


class _Version(argparse.Action):
    """Prints the version; the lookup is made only when it is requested."""

    def __init__(self, option_strings: list[str], dest: str, **kwargs: object) -> None:
        super().__init__(option_strings, dest, nargs=0, help=str(kwargs.get("help")))

    def __call__(self, parser: argparse.ArgumentParser, *_ignored: object) -> None:
        from skd_evaluator.version import version

        print(f"skd {version()}")
        parser.exit()


def _add_assess(commands: Any) -> None:
    assess = commands.add_parser(
        "assess",
        help="rate one car: its margin and its SKD",
        description="Rate one car. A safe trajectory φ is how an adversary (say, a pedestrian) crosses unharmed; a "
        "kamikaze leaves it in order to be hit. The margin is the least deviation from φ with which the moving car "
        "hits; it is a property of the car. The Safe-Kamikaze Distance (SKD), the paper's measure, says how far "
        "kamikazes deviate who plan with what they know about the car.",
    )
    add_car_arguments(assess, "assess")
    add_graph_arguments(assess, "assess", optional=True)
    add_campaign_arguments(assess, "assess")
    add_gate_arguments(assess)
    add_flag(assess, "--details", _DETAILS)
    add_flag(assess, "--no-pictures", "draw no pictures beside the figures, which saves about a second")
    assess.add_argument(
        "--until-width",
        type=positive_number,
        metavar="W",
        help="add --safe-count safe trajectories at a time, at most 10 times, until the 95 %% interval of the planned "
        "deviation is at most W metres wide; intervals allow for being looked at repeatedly",
    )


def _add_sweep(commands: Any) -> None:
    sweep = commands.add_parser(
        "sweep",
        help="the paper's experiment: rate the basic car with nine multipliers C",
        description="Repeat the paper's experiment: margin, SKD and contact rate of the basic car with each multiplier "
        "C, on synthetic safe trajectories and, if --safe gives them, on recorded ones or walkers.",
    )
    text = "walkers, or recorded safe trajectories: CITR's vci_lat_uni, a csv file with columns t, x, y, or a folder"
    sweep.add_argument("--safe", metavar="SOURCE", help=text)
    text = "rate the basic car with these multipliers C instead of the paper's nine (0.5 to 1.15)"
    sweep.add_argument("--multipliers", type=real_number(0.0, 100.0), nargs="+", metavar="C", help=text)
    add_options(sweep, "sweep", CAR_GROUP)
    add_campaign_arguments(sweep, "sweep")


def _add_episode(commands: Any) -> None:
    episode = commands.add_parser(
        "episode",
        help="run one episode through the node graph and record it",
        description="Run one episode through the node graph and record it as a bag.",
    )
    add_car_arguments(episode, "episode")
    text = (
        "what the adversary does: safe (cross unharmed), kamikaze (be hit), replay (follow a safe trajectory), or risk "
        "(walk it as people do, as --behaviour and --scale say) (default: kamikaze)"
    )
    episode.add_argument("--mode", choices=("safe", "kamikaze", "replay", "risk"), default="kamikaze", help=text)
    add_options(episode, "episode", table=AssessmentOptions)
    text = "with --mode risk, by what the deviations of people are multiplied (default: 1)"
    episode.add_argument("--scale", type=positive_number, default=1.0, metavar="S", help=text)
    add_count(episode, "--trial", 0, 2**63 - 1, "which trial of the assessment to repeat, from 0", default=0)
    # A single episode has one objective, and one φ: that of a campaign with as many.
    single = {
        "default": str(CampaignOptions.objective),
        "choices": OBJECTIVES,
        "metavar": "NAME",
        "help": "what the kamikaze is rewarded for: deviation (a small one), paper (colliding soon), or frechet (a "
        "small Fréchet distance to φ) (default: %(default)s)",
    }
    add_options(episode, "episode", "campaign", objective=single)
    text = "how many safe trajectories the assessment has to which this episode belongs"
    add_count(episode, "--safe-count", 1, 65_535, text, default=1)
    add_count(episode, "--safe-number", 0, 65_534, "which of them the episode is about, from 0", default=0)
    add_graph_arguments(episode, "episode", optional=False)
    add_parameters(episode)
    add_output_arguments(episode)


def _add_replay(commands: Any) -> None:
    replay = commands.add_parser(
        "replay",
        help="rate a car from recorded episodes (MCAP logs)",
        description="Rate a car from recorded episodes, offline, recorded by SKD or by ros2 bag record.",
    )
    add_paths(replay, "paths", "PATH", "a bag folder, an .mcap file, or a folder of them")
    replay.add_argument("--campaign", metavar="NAME", help="which campaign to rate, if the bags hold several")
    text = "leave out each kamikaze that ended up further than this many metres from its safe trajectory"
    replay.add_argument("--maximum-distance", type=positive_number, metavar="M", help=text)
    add_max_aborted_argument(replay)
    add_options(replay, "replay", table=AssessmentOptions)
    add_damage_argument(replay)
    add_flag(replay, "--details", _DETAILS)
    add_gate_arguments(replay)
    add_output_arguments(replay)


def _add_compare(commands: Any) -> None:
    compare = commands.add_parser(
        "compare",
        help="put assessments side by side and say which car is safer",
        description="Put results of skd assess side by side: their figures in one table, their vulnerability curves in "
        "one picture. Of each car it says whether it is safer or less safe than the first, or cannot be told apart "
        "from it. That goes by margin and risk: one of them has to differ, and none the other way. Results about the "
        "same safe trajectories φ are compared trajectory by trajectory.",
    )
    add_paths(compare, "paths", "DIR", "folder of an assessment; the others are compared with the first")
    add_flag(compare, "--no-pictures", "draw no pictures beside comparison.json, which saves about half a second")
    add_output_arguments(compare)


def _add_verify(commands: Any) -> None:
    verify = commands.add_parser(
        "verify",
        help="check that results are unchanged and follow from their episodes",
        description="Compare the files of a result with their checksums, compute every figure anew from the episodes, "
        "and check that each episode can have happened. The exit code is 1 if something does not agree.",
    )
    add_paths(verify, "paths", "DIR", "folder of an assessment, a sweep or a campaign, or a folder of such")
    add_flag(verify, "--json", "print JSON, which names every figure, instead of lines")


def _add_plan(commands: Any) -> None:
    plan = commands.add_parser(
        "plan",
        help="say how many safe trajectories a precision takes",
        description="Say how many safe trajectories φ, and how many kamikazes for each, it takes until an interval is "
        "narrow enough, or a difference between two cars is found. It goes by how much an earlier result varies from "
        "φ to φ, and between kamikazes of the same φ.",
    )
    text = (
        "folder of an earlier assessment; for --difference two that are about the same φ (default: what the basic "
        "car's figures vary by)"
    )
    add_paths(plan, "paths", "DIR", text, nargs="*")
    goal = plan.add_mutually_exclusive_group(required=True)
    text = "width of the 95 %% interval, in the figure's unit: m, or a share of runs"
    goal.add_argument("--width", type=positive_number, metavar="W", help=text)
    text = "difference between two cars that has to be found, m"
    goal.add_argument("--difference", type=positive_number, metavar="D", help=text)
    text = "probability with which the difference has to be found (default: 0.8)"
    plan.add_argument("--power", type=real_number(0.06, 0.9999), default=0.8, metavar="P", help=text)
    add_flag(plan, "--unpaired", "the two cars are rated on different safe trajectories")
    plan.add_argument(
        "--figure",
        choices=("margin", "deviation", "skd", "contact_rate"),
        default="margin",
        help="which figure; of contact_rate runs along φ are counted instead of kamikazes (default: margin)",
    )
    add_count(plan, "--kamikaze-count", 2, 1_000_000, "say only how many φ it takes with this many kamikazes for each")
    add_flag(plan, "--json", "print JSON instead of a table")


def _add_report(commands: Any) -> None:
    report = commands.add_parser(
        "report",
        help="write one HTML file: figures, charts, and every episode with a player",
        description="Write results into one HTML file: figures with their intervals, charts, maps, and every episode "
        "with a player and the command that repeats it. The file needs no other file and no network.",
    )
    add_paths(report, "paths", "DIR", "folder of an assessment, a sweep or a campaign")
    add_output_arguments(report, "FILE", "the HTML file to write (default: skd_results/report-<time>.html)")


def _add_show(commands: Any) -> None:
    show = commands.add_parser(
        "show",
        help="draw the worst episodes of a result, or one of them, as pictures or films",
        description="Draw episodes of a result, the worst for the car first: as seen from above, with the distances "
        "over time. For each it also prints the command that repeats the episode.",
    )
    add_paths(show, "path", "RESULT", "folder of an assessment", nargs=None)
    which = show.add_mutually_exclusive_group()
    add_count(which, "--worst", 1, 1000, "how many episodes to draw, the worst for the car first", default=1)
    text = "draw the episode that has this id in episodes.npz and bags"
    which.add_argument("--episode", type=whole_number(0), metavar="ID", help=text)
    text = "draw so many of the risk's most likely failures: of each kind the nearest to how people walk"
    add_count(which, "--failures", 1, 1000, text)
    text = "draw only kamikazes of this objective (default: all episodes)"
    show.add_argument("--objective", metavar="NAME", help=text)
    text = "png for pictures; gif or mp4 for films at half speed, of which mp4 needs ffmpeg (default: png)"
    show.add_argument("--format", choices=("png", "gif", "mp4"), default="png", help=text)
    add_output_arguments(show)


def _add_scenarios(commands: Any) -> None:
    scenarios = commands.add_parser(
        "scenarios",
        help="list scenarios, show one, check a file of your own",
        description="list: the scenarios that have a name. show: what happens in some of them, with a picture each. "
        "check: the same of files of your own, after the checks that an assessment makes. campaign: the file of a "
        "campaign in which scenarios are run at several test speeds.",
    )
    scenarios.add_argument("action", choices=("list", "show", "check", "campaign"), help="what to do")
    scenarios.add_argument("names", nargs="*", metavar="NAME", help="names or files of scenarios")
    text = "test speeds of the car, km/h, as 10:60:10; with campaign"
    scenarios.add_argument("--speeds", type=steps_of("km/h", 0.0, 200.0), metavar="FROM:TO:STEP", help=text)
    text = (
        "folder for the pictures (default: skd_results/scenarios-<time>; with list none are made), or with campaign "
        "the file to write (default: standard output)"
    )
    add_output_arguments(scenarios, "PATH", text)


def _add_probe(commands: Any) -> None:
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
    add_parameters(probe)
    add_output_arguments(probe)


def _add_fit(commands: Any) -> None:
    fit = commands.add_parser(
        "fit",
        help="learn a model of a car from recorded episodes, or of how people walk",
        description="Estimate by maximum likelihood how a car brakes, from recorded episodes, and write the model to "
        "car_model.yaml, with which skd assess --car-model lets the adversary plan. With --people fit a behaviour "
        "model to tracks, check it on people whom it has not seen, and write it to behaviour.yaml, with which skd "
        "assess --behaviour estimates the risk.",
    )
    text = (
        "a bag folder, an .mcap file, an episodes.npz, or a folder of them; with --people also CITR's vci_lat_uni, or "
        "csv files with columns t, x, y (x along the intended path)"
    )
    add_paths(fit, "paths", "PATH", text)
    people = fit.add_argument_group("people")
    add_flag(people, "--people", "fit a behaviour model to tracks of people, not a model of a car")
    people.add_argument("--name", default="fitted", metavar="NAME", help="what it is called (default: fitted)")
    text = "the kind of road user (default: pedestrian)"
    people.add_argument("--kind", default="pedestrian", metavar="KIND", help=text)
    add_damage_argument(fit)
    add_output_arguments(fit)


def _add_list(commands: Any) -> None:
    listed = commands.add_parser(
        "list",
        help="list the assessments under a folder, or how a car has changed from one to the next",
        description="List the assessments in and under folders, cells of campaigns and sweeps included: car, margin, "
        "date, and the commit of the car's code. With --trend follow a figure of each car over the dates, and say "
        "whether the car is safer or less safe than in the assessment before, judged as skd compare does; all verdicts "
        "of a car together are right with 95 percent.",
    )
    text = f"folder of results, or one above some (default: {_DEFAULT_FOLDER})"
    add_paths(listed, "paths", "DIR", text, nargs="*", default=[_DEFAULT_FOLDER])
    listed.add_argument("--car", metavar="TEXT", help="only cars whose name holds this text")
    listed.add_argument("--scenario", metavar="TEXT", help="only scenarios whose name holds this text")
    order = ("date", "folder", "car", "margin", "nominal_collision_rate")
    listed.add_argument("--sort", choices=order, default="date", help="in which order (default: date)")
    add_count(listed, "--last", 1, 1_000_000, "only so many, the last of the order")
    listed.add_argument("--trend", choices=_FIGURES, help="follow this figure of each car from result to result")
    add_flag(listed, "--json", "print JSON instead of a table")


def _add_doctor(commands: Any) -> None:
    doctor = commands.add_parser(
        "doctor",
        help="say what is installed, what is missing, and for what",
        description="Look at what SKD needs and at what is optional, say what to do about what is missing, and send a "
        "message between two nodes of ROS 2. The exit code is 1 where something does not work.",
    )
    add_flag(doctor, "--no-round-trip", "start no nodes: look at files alone")
    add_flag(doctor, "--json", "print JSON instead of lines")


def _add_drive(commands: Any) -> None:
    drive = commands.add_parser(
        "drive",
        help="watch a car drive, and step in front of it with the keyboard",
        description="Watch a car drive in real time, in the terminal: as seen from above, with its speed, its commands "
        "and their age. The adversary goes where your keys send it, or follows a safe trajectory φ. With --graph, RViz "
        "and Foxglove can show the drive, too. Nothing is rated, and only a run that fails leaves its logs. Without a "
        "terminal it prints one line a second and ends with the first episode.",
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
    add_graph_arguments(drive, "drive", optional=True, record=False)
    add_parameters(drive)
    group = drive.add_argument_group("output")
    add_flag(group, "--json", "print how each episode ended as JSON, and no picture")
    add_loudness(group)

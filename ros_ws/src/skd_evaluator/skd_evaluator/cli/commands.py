"""The commands in their groups, and their options. Light: it is imported at every start."""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.options.adversary import OBJECTIVES
from skd_sim.options.registry import Registry

from skd_evaluator.assessment.options import AssessmentOptions, CampaignOptions
from skd_evaluator.cli.arguments import (
    CAR_GROUP,
    EXIT_USAGE,
    Parser,
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
    rare,
    real_number,
    steps_of,
    whole_number,
)
from skd_evaluator.cli.gate import add_gate_arguments

COMMANDS = "skd.commands"
"""Group of entry points: functions that add a command's parser to what `ArgumentParser.add_subparsers` returns. The
parser's default `module` names the module whose `run` is given the arguments and returns the exit code."""
GROUPS = {
    "rate": ("assess", "campaign", "ncap", "replay", "episode", "drive"),
    "look": ("report", "list", "scenarios", "doctor"),
    "compare and gate": ("compare", "verify"),
    "exchange": ("export", "import"),
    "research": ("sweep", "probe", "fit", "fuse"),
}
"""The commands as the help shows them; those of installed packages come last."""
_DEFAULT_FOLDER = Path("skd_results")
_DETAILS = "print every figure, and a line for each safe trajectory"
_FIGURES = ("margin", "deviation", "skd", "nominal_collision_rate", "risk_1")


class _Skd(Parser):
    """The parser of all commands, whose help has them in groups."""

    def format_help(self) -> str:
        """Return the help."""
        (commands,) = (one for one in self._actions if isinstance(one, argparse._SubParsersAction))
        said = {one.dest: one.help or "" for one in commands._choices_actions}
        known = {name for names in GROUPS.values() for name in names}
        lines = ["usage: skd COMMAND [options]", "", str(self.description)]
        for title, names in {**GROUPS, "of installed packages": tuple(said.keys() - known)}.items():
            rows = [f"  {name:<10}{said[name]}" for name in names if name in said]
            lines += ["", title, *rows] if rows else []
        return "\n".join([*lines, "", "skd COMMAND --help explains a command, skd --version names the version.", ""])


def make_parser(words: Sequence[str] = ()) -> Parser:
    """Return the parser of all commands; of SKD's own alone if the first word is one of these, which is quicker."""
    Parser.everything = "--help-all" in words
    parser = _Skd(
        prog="skd",
        description="Measure how far a pedestrian may deviate from a safe crossing before a self-driving car collides.",
    )
    parser.add_argument("--version", action=_Version, help="print the version and exit")
    commands = parser.add_subparsers(dest="command", required=True, metavar="COMMAND", parser_class=Parser)
    for add in (
        _add_assess, _add_sweep, _add_episode, _add_replay, _add_compare, _add_verify, _add_report, _add_scenarios,
        _add_probe, _add_fit, _add_list, _add_doctor, _add_drive,
    ):  # fmt: skip
        add(commands)
    if not words or words[0] not in commands.choices:
        registry = Registry("command", COMMANDS, dict.fromkeys(commands.choices, ""))
        for name in registry.registered():
            try:
                registry.find(name)(commands)
            except UsageError as error:  # it cannot be loaded
                commands.add_parser(name, help=str(error)).set_defaults(problem=str(error))
    for one in commands.choices.values():
        one.add_argument("--help-all", action="help", help="show all options, rare ones too, and exit")
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
        help="rate one car: its safety margin, nominal collision rate and risk",
        description="Rate one car. Pedestrians cross on safe trajectories φ. The safety margin is the least deviation "
        "from φ with which the moving car hits. Kamikazes are pedestrians that plan to be hit with what they know: "
        "their distance from φ is the Safe-Kamikaze Distance (SKD).",
    )
    add_car_arguments(assess, "assess")
    add_graph_arguments(assess, "assess", optional=True)
    add_campaign_arguments(assess, "assess")
    add_gate_arguments(assess)
    add_flag(assess, "--resume", "go on with the assessment in --out that was interrupted")
    add_flag(assess, "--details", _DETAILS)
    add_flag(assess, "--no-pictures", rare("draw no pictures, which saves about a second"))
    text = "add --safe-count trajectories at a time, at most 10 times, until the planned deviation's interval is W wide"
    assess.add_argument("--until-width", type=positive_number, metavar="W", help=rare(text))


def _add_sweep(commands: Any) -> None:
    sweep = commands.add_parser(
        "sweep",
        help="the paper's experiment: rate the basic car with nine multipliers C",
        description="Repeat the paper's experiment: margin, SKD and contact rate of the basic car with each multiplier "
        "C. The safe trajectories are synthetic ones, and those of --safe, if given.",
    )
    text = "walkers, or recorded ones: CITR's vci_lat_uni, a csv file with columns t, x, y, or a folder"
    sweep.add_argument("--safe", metavar="SOURCE", help=text)
    text = "rate the basic car with these multipliers C instead of the paper's nine (0.5 to 1.15)"
    sweep.add_argument("--multipliers", type=real_number(0.0, 100.0), nargs="+", metavar="C", help=text)
    add_options(sweep, "sweep", CAR_GROUP)
    # The paper's numbers; for a rating more φ say more than more trials on each.
    paper = {
        name: {"default": count, "help": f"how many {what} (default: {count})"}
        for name, count, what in (
            ("safe_count", 5, "safe trajectories (φ) there are of each kind"),
            ("kamikaze_count", 100, "kamikazes are planned for each safe trajectory"),
        )
    }
    add_campaign_arguments(sweep, "sweep", **paper)


def _add_episode(commands: Any) -> None:
    episode = commands.add_parser(
        "episode",
        help="run one episode through the node graph and record it",
        description="Run one episode through the node graph and record it as a bag.",
    )
    add_car_arguments(episode, "episode")
    text = "the adversary crosses safely, is hit, follows φ, or walks φ with natural variation (default: kamikaze)"
    episode.add_argument("--mode", choices=("safe", "kamikaze", "replay", "risk"), default="kamikaze", help=text)
    add_options(episode, "episode", table=AssessmentOptions, hidden=("behaviour",))
    text = rare("with --mode risk, by what the deviations of people are multiplied (default: 1)")
    episode.add_argument("--scale", type=positive_number, default=1.0, metavar="S", help=text)
    add_count(episode, "--trial", 0, 2**63 - 1, "which trial of the assessment to repeat, from 0", default=0)
    # A single episode has one objective, and one φ: that of a campaign with as many.
    single = {
        "default": str(CampaignOptions.objective),
        "choices": OBJECTIVES,
        "metavar": "NAME",
        "help": "what the kamikaze is rewarded for: deviation, paper or frechet (default: %(default)s)",
    }
    add_options(episode, "episode", "campaign", hidden=("simulations",), objective=single)
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
    text = "leave out each kamikaze that ended further than this many metres from its safe trajectory"
    replay.add_argument("--maximum-distance", type=positive_number, metavar="M", help=rare(text))
    add_max_aborted_argument(replay)
    add_options(replay, "replay", table=AssessmentOptions)
    add_damage_argument(replay)
    add_flag(replay, "--details", _DETAILS)
    add_gate_arguments(replay)
    add_output_arguments(replay)


def _add_compare(commands: Any) -> None:
    compare = commands.add_parser(
        "compare",
        help="put results side by side: which car is safer, and how many trajectories it takes to tell",
        description="Put results side by side, and say whether each car is safer or less safe than the first. That "
        "goes by margin and risk: one of them has to differ, and none the other way. With --width or --difference it "
        "says how many safe trajectories φ a precision takes, by how much earlier results vary.",
    )
    text = "folder of an assessment, a campaign, or one above some; the others are compared with the first"
    add_paths(compare, "paths", "DIR", text, nargs="*")
    add_flag(compare, "--no-pictures", rare("draw no pictures, which saves about half a second"))
    size = compare.add_argument_group("how many trajectories")
    goal = size.add_mutually_exclusive_group()
    text = "until the 95 %% interval is this wide, in the figure's unit: m, or a share of runs"
    goal.add_argument("--width", type=positive_number, metavar="W", help=text)
    text = "until this difference between two cars is found, m"
    goal.add_argument("--difference", type=positive_number, metavar="D", help=text)
    text = "probability with which the difference is found (default: 0.8)"
    size.add_argument("--power", type=real_number(0.06, 0.9999), default=0.8, metavar="P", help=text)
    add_flag(size, "--unpaired", "the two cars are rated on different safe trajectories")
    choices = ("margin", "deviation", "skd", "contact_rate")
    size.add_argument("--figure", choices=choices, default="margin", help="which figure (default: margin)")
    add_count(size, "--kamikaze-count", 2, 1_000_000, "only with this many kamikazes for each φ")
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


def _add_report(commands: Any) -> None:
    report = commands.add_parser(
        "report",
        help="write one HTML file with a player of all episodes, or pictures and films of the worst",
        description="Write results into one HTML file: figures, charts, maps, and every episode with a player. The "
        "file needs no other file and no network. With --format png, gif or mp4 draw the worst episodes of one result, "
        "and print the command that repeats each.",
    )
    add_paths(report, "paths", "DIR", "folder of an assessment, a sweep or a campaign, or one above some")
    text = "html for the page, png for pictures, gif or mp4 (with ffmpeg) for films at half speed (default: html)"
    report.add_argument("--format", choices=("html", "png", "gif", "mp4"), default="html", help=text)
    which = report.add_argument_group("pictures and films").add_mutually_exclusive_group()
    add_count(which, "--worst", 1, 1000, "how many episodes to draw, the worst for the car first", default=1)
    which.add_argument("--episode", type=whole_number(0), metavar="ID", help="draw the episode with this id")
    add_count(which, "--failures", 1, 1000, "draw so many of the risk's most likely failures, of each kind in turn")
    text = "draw only kamikazes of this objective (default: all episodes)"
    report.add_argument("--objective", metavar="NAME", help=text)
    text = "the HTML file, or the folder for pictures (default: skd_results/report-<time>)"
    add_output_arguments(report, "PATH", text)


def _add_scenarios(commands: Any) -> None:
    scenarios = commands.add_parser(
        "scenarios",
        help="list scenarios, show one, check a file of your own",
        description="list: scenarios that have a name. show: what happens in some, with a picture each. check: the "
        "same of files of your own. campaign: the file of a campaign at several test speeds.",
    )
    actions = ("list", "show", "check", "campaign")
    scenarios.add_argument("action", choices=actions, metavar="ACTION", help=f"what to do: {', '.join(actions)}")
    scenarios.add_argument("names", nargs="*", metavar="NAME", help="names or files of scenarios")
    text = "with campaign, test speeds of the car, km/h, as 10:60:10"
    scenarios.add_argument("--speeds", type=steps_of("km/h", 0.0, 200.0), metavar="FROM:TO:STEP", help=text)
    text = "folder for the pictures, or with campaign the file to write (default: skd_results/scenarios-<time>)"
    add_output_arguments(scenarios, "PATH", text)


def _add_probe(commands: Any) -> None:
    probe = commands.add_parser(
        "probe",
        help="run episodes that show how a car reacts, for skd fit",
        description="Run varied crossings that show when and how a car brakes. They are kept for skd fit: as "
        "episodes.npz, with --graph as bags.",
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
        description="Estimate how a car brakes from recorded episodes, and write car_model.yaml for skd assess "
        "--car-model. With --people fit tracks of people, check the model on people held out, and write behaviour.yaml "
        "for skd assess --behaviour.",
    )
    text = "a bag folder, an .mcap file, episodes.npz, or a folder of them. With --people: CITR, or csv with t, x, y"
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
        help="list results under a folder, or how a car has changed from one to the next",
        description="List the assessments in and under folders: car, margin, date, and commit of the car's code. With "
        "--trend say of each car whether it is safer than in the assessment before, as skd compare does.",
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
        description="Say what is installed, what is missing and what to do about it. Send a message between two ROS 2 "
        "nodes. The exit code is 1 where something does not work.",
    )
    add_flag(doctor, "--no-round-trip", "start no nodes: look at files alone")
    add_flag(doctor, "--json", "print JSON instead of lines")


def _add_drive(commands: Any) -> None:
    drive = commands.add_parser(
        "drive",
        help="watch a car drive, and step in front of it with the keyboard",
        description="Watch a car drive in real time, in the terminal. The adversary goes where your keys send it, or "
        "follows a safe trajectory φ. With --graph, RViz and Foxglove can show the drive, too. Nothing is rated. "
        "Without a terminal it prints one line a second and ends with the first episode.",
    )
    followed = "follow safe trajectories φ instead of the keys; as skd assess takes them (default: it goes by keys)"
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

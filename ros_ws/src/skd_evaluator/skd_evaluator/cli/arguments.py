"""The parser of a command, with the options that several share, and what they make of them. Light: help reads it."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from skd_sim.errors import UsageError
from skd_sim.inputs.files import did_you_mean
from skd_sim.options.options import RARE, Option, options_of, read_options, values_of

from skd_evaluator.assessment import options
from skd_evaluator.assessment.options import CampaignOptions, GraphOptions
from skd_evaluator.cli.output import EXIT_USAGE

if TYPE_CHECKING:
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.run.workers import Workers

CAR_GROUP = "car and test"
DETAILS = "print every figure, and a line for each safe trajectory"
Parse = Callable[[str], Any]
_MOST_STEPS = 100
_SUGGESTIONS = {"explain": "; did you mean 'compare --explain'?", "show": "; did you mean 'report' or 'list'?"}
"""Suggestions for commands that other tools have and SKD does not."""


def _number(kind: type[int] | type[float], low: float, high: float, *, above: bool = False) -> Parse:
    what = "whole" if kind is int else "finite"

    def parse(text: str) -> Any:
        try:
            value = kind(text)
        except ValueError:
            value = low - 1
        if not (math.isfinite(value) and low <= value <= high) or (above and value == low):
            lowest = f"{'>' if above else '≥'} {low:g}"
            allowed = f"≤ {high:g}" if math.isfinite(value) and value > high else lowest
            raise argparse.ArgumentTypeError(f"must be a {what} number {allowed}, got {text!r}")
        return value

    return parse


def whole_number(low: int, high: int = 2**63 - 1) -> Parse:
    """Return a parser of whole numbers from `low` to `high`."""
    return _number(int, low, high)


def real_number(low: float, high: float = math.inf, *, above: bool = False) -> Parse:
    """Return a parser of finite numbers from `low` to `high`; with `above`, `low` itself is none of them."""
    return _number(float, low, high, above=above)


positive_number = real_number(0.0, above=True)


def percentage(text: str) -> float:
    """Parse a percentage from 0 to 100, and return it as a share."""
    return float(real_number(0.0, 100.0)(text)) / 100.0


def _three_numbers(text: str, separator: str) -> tuple[float, ...]:
    """Return the three finite numbers of a text; nothing where it holds others."""
    try:
        found = tuple(float(part) for part in text.split(separator))
    except ValueError:
        return ()
    return found if len(found) == 3 and all(map(math.isfinite, found)) else ()


def speeds(text: str) -> list[float]:
    """Parse speeds (km/h) above 0 and up to 200, as FROM:TO:STEP, both ends included."""
    first, last, step = _three_numbers(text, ":") or (0.0, 0.0, 0.0)
    count = int((last - first) / step + 1e-9) + 1 if step > 0.0 else 0
    if not (0.0 < first <= last <= 200.0 and 1 <= count <= _MOST_STEPS):
        allowed = f"in km/h, above 0 and up to 200, at most {_MOST_STEPS} values"
        raise argparse.ArgumentTypeError(f"must be FROM:TO:STEP {allowed}, as 10:60:10; got {text!r}")
    return [first + step * number for number in range(count)]


def frame_place(text: str) -> tuple[float, float, float]:
    """Parse X,Y,DEGREES: where one frame lies in another."""
    if not (found := _three_numbers(text, ",")):
        raise argparse.ArgumentTypeError(f"must be X,Y,DEGREES, such as 12.5,-3,90, got {text!r}")
    x, y, degrees = found
    return x, y, degrees


def command_line(text: str) -> str:
    """Return a command line that is not empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError("is empty; leave it out where you start the controller yourself")
    return text


class Options(argparse._ActionsContainer):
    """What options are added to: the parser of a command, or a group of its options."""

    def add_argument_group(self, *words: Any, **rest: Any) -> OptionGroup:
        """Add a group of options under a heading."""
        self._action_groups.append(group := OptionGroup(self, *words, **rest))
        return group

    def add_mutually_exclusive_group(self, **rest: Any) -> ExclusiveOptions:
        """Add a group of options of which one may be given."""
        self._mutually_exclusive_groups.append(group := ExclusiveOptions(self, **rest))
        return group

    def add_value(self, name: str, text: str, **rest: Any) -> None:
        """Add an option or an argument, as `add_argument` does; the help says its default, if it has one."""
        if text != argparse.SUPPRESS and rest.get("default") not in (None, ()) and "default:" not in text:
            text += " (default: %(default)s)"
        self.add_argument(name, help=text, **rest)

    def add_count(self, flag: str, low: int, high: int, text: str, *, default: int | None = None) -> None:
        """Add a whole number from `low` to `high`; the help says its default, if it has one."""
        self.add_value(flag, text, type=whole_number(low, high), default=default, metavar="N")

    def add_flag(self, flag: str, text: str) -> None:
        """Add an option that is given or not; one that begins with --no- stores False under the rest of its name."""
        if flag.startswith("--no-"):
            self.add_argument(flag, dest=flag[5:].replace("-", "_"), action="store_false", help=text)
        else:
            self.add_argument(flag, action="store_true", help=text)

    def add_paths(self, metavar: str, text: str, **rest: Any) -> None:
        """Add `paths`: files or folders, one or more of them."""
        self.add_argument("paths", type=Path, **{"nargs": "+", **rest}, metavar=metavar, help=text)

    def add_options(
        self,
        title: str = "",
        table: Callable[..., Any] = CampaignOptions,
        hidden: Sequence[str] = (),
        **changes: Mapping[str, Any],
    ) -> None:
        """Add the options of a table that the command takes.

        Args:
            title: add only the options of the group with this title; all by default.
            table: the dataclass whose fields are the options.
            hidden: names of options that are rare for this command.
            changes: other arguments for `add_argument`, by name of the option.
        """
        known: dict[str, tuple[Option, Callable[..., Any]]] = self._defaults.setdefault("parameters", {})
        for one in options_of(table):
            if self._defaults["command"] in one.commands and title in ("", one.group):
                known[one.name] = (one, table)
                found = {**_argument(one), **changes.get(one.name, {})}
                if RARE in one.marks or one.name in hidden:
                    found["help"] = rare(found["help"])
                self.add_argument(one.flag, **found)

    def add_workers(self) -> None:
        """Add --workers."""
        self.add_count(
            "--workers", 1, options.MOST_WORKERS, "how many processes run the episodes (default: one per core)"
        )

    def add_runner(self) -> None:
        """Add the options that say where episodes run in process."""
        where = self.add_mutually_exclusive_group()
        where.add_workers()
        text = "address of a Dask cluster that runs the episodes, such as tcp://host:8786 (docs/campaigns.md)"
        where.add_value("--scheduler", rare(text), metavar="ADDRESS")

    def add_max_aborted(self) -> None:
        """Add --max-aborted."""
        text = rare("how many episodes of any figure may be aborted before the exit code is 1, %% (default: 5)")
        self.add_value("--max-aborted", text, type=percentage, default=options.MAXIMUM_ABORTED, metavar="PERCENT")

    def add_skip_damaged(self) -> None:
        """Add --skip-damaged."""
        text = "leave out and count episodes that are damaged or implausible, instead of refusing all"
        self.add_flag("--skip-damaged", text)

    def add_loudness(self) -> None:
        """Add -v and -q."""
        loudness = self.add_mutually_exclusive_group()
        verbose = rare("show where in SKD an error comes from")
        loudness.add_argument("-v", "--verbose", action="store_true", help=verbose)
        loudness.add_argument("-q", "--quiet", action="store_true", help=rare("print no tables and no progress"))


class OptionGroup(Options, argparse._ArgumentGroup):
    """Options under a heading of the help."""


class ExclusiveOptions(Options, argparse._MutuallyExclusiveGroup):
    """Options of which one may be given."""


class Parser(Options, argparse.ArgumentParser):
    """A parser whose errors and usage are one line, and whose help leaves out what is rare.

    Attributes:
        everything: whether the help has all options.
    """

    everything = False

    def __init__(self, **rest: Any) -> None:
        """Make a parser that takes no option by its beginning alone: a later version may have two of them."""
        super().__init__(**{**rest, "allow_abbrev": False})

    def error(self, message: str) -> NoReturn:
        """Leave with the message."""
        self.exit(EXIT_USAGE, f"{self.prog}: error: {message} (see {self.prog} --help)\n")

    def format_help(self) -> str:
        """Return the help, with a short usage, and how many options it leaves out."""
        self.usage = " ".join([self.prog, *filter(None, map(_usage, self._actions)), "[options]"])
        hidden = sum(
            one.help is argparse.SUPPRESS and not isinstance(one, argparse._HelpAction) for one in self._actions
        )
        self.epilog = f"--help-all shows {hidden} more option{'s' * (hidden > 1)}." if hidden else None
        return super().format_help()

    def _print_message(self, message: str, file: Any = None) -> None:
        if message and file is not None and file is sys.stdout:
            file.write(message)  # Python's own drops without a word what the disk does not take
        else:
            super()._print_message(message, file)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            if near := _SUGGESTIONS.get(value) or did_you_mean(str(value), map(str, action.choices or ())):
                error.message = f"invalid choice: {value!r}{near}"
            raise

    def add_car(self, **changes: Any) -> None:
        """Add the options that say which car meets whom; `changes` as `add_options` takes them."""
        group = self.add_argument_group(CAR_GROUP)
        group.add_options(CAR_GROUP, hidden=("simulator", "car_model"), **changes)
        text = "name or YAML file of the scenario (default: crossing, with CITR data citr_crossing)"
        group.add_value("--scenario", text, metavar="NAME")

    def add_campaign(self, **changes: Any) -> OptionGroup:
        """Add what `assess` and `sweep` share, and return the output's group; `changes` as `add_options` takes them."""
        group = self.add_argument_group("how much is driven")
        hidden = ("simulations", "objective", "behaviour")
        group.add_options("campaign", hidden=hidden, **changes)
        group.add_max_aborted()
        group.add_options(table=options.AssessmentOptions, hidden=hidden)
        group.add_runner()
        self.add_parameters()
        return self.add_output()

    def add_graph(self, *, optional: bool = True, record: bool = False) -> None:
        """Add the options of the node graph; with `optional` also --graph, with `record` --record."""
        group = self.add_argument_group("node graph")
        if optional:
            group.add_flag("--graph", "run the episodes through a graph of ROS 2 nodes")
        if record:
            group.add_flag("--record", "keep a bag of every episode; needs --graph")
        hidden = ("pacing",) if optional else ()
        group.add_options(table=GraphOptions, hidden=hidden, controller_command={"type": command_line})

    def add_parameters(self) -> None:
        """Add -p and --params-file, as ROS 2 has them, for all options of the command's tables.

        The command line counts more than a file.
        """
        self.set_defaults(read_parameters=parameters_of)
        group = self.add_argument_group("parameters")
        text = rare("an option by name, as ROS 2 has parameters")
        group.add_argument("-p", "--param", action="append", default=[], metavar="NAME:=VALUE", help=text)
        text = rare("YAML file of options by name, also as ROS 2 writes parameters")
        group.add_value("--params-file", text, type=Path, metavar="FILE")

    def add_output(
        self, metavar: str = "DIR", text: str = "folder for the results (default: skd_results/<command>-<time>)"
    ) -> OptionGroup:
        """Add --out, --overwrite, --json, -v and -q, and return their group."""
        group = self.add_argument_group("output")
        group.add_value("--out", text, type=Path, metavar=metavar)
        group.add_flag("--overwrite", "replace what --out names, if it exists")
        group.add_flag("--json", "print JSON, and nothing else, on standard output")
        group.add_loudness()
        return group


def _usage(one: argparse.Action) -> str:
    """Return how an argument stands in the usage; nothing for what may be left out."""
    name = str(one.metavar or one.dest.upper())
    if one.option_strings:
        return f"{one.option_strings[0]} {name}" if one.required else ""
    many = f"{name} …" if one.nargs in ("+", "*") else name
    return f"[{many}]" if one.nargs in ("?", "*") else many


def rare(text: str) -> str:
    """Return the text of an option that only --help-all shows."""
    return text if Parser.everything else argparse.SUPPRESS


def _argument(one: Option) -> dict[str, Any]:
    """Return the arguments of `add_argument` for an option."""
    if one.kind is bool:
        return {"action": "store_true", "help": one.text.replace("%", "%%")}
    found: dict[str, Any] = {"default": one.unsaid, "metavar": one.metavar, "help": described(one).replace("%", "%%")}
    if one.choices is not None:
        return {**found, "choices": one.choices, "metavar": one.metavar or f"{{{','.join(one.choices.own)}}}"}
    if one.kind is tuple:
        found["action"] = "append"
    low, high = (-math.inf if one.low is None else one.low), (math.inf if one.high is None else one.high)
    if one.kind in (int, float):
        found["type"] = _number(one.kind, low, high, above=one.kind is float and one.absent is not None)
    return found


def described(one: Option) -> str:
    """Return what an option means, and its default."""
    default = one.unsaid
    said = one.unset if default in (None, "") else f"{default:g}" if one.kind is float else str(default)
    return f"{one.text} (default: {said})"


def parameters_of(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the options that -p and --params-file give, by name.

    Raises:
        UsageError: a file cannot be read, or the command has no such option or no such value of it.
    """
    if not (arguments.param or arguments.params_file):
        return {}
    from skd_sim.inputs.yaml_file import parse_yaml, read_yaml  # only now: every command begins with this module

    found: dict[str, Any] = {}
    if (file := arguments.params_file) is not None:
        content = read_yaml(file)
        while isinstance(content, dict) and len(content) == 1:  # /**: ros__parameters: {…}
            (inner,) = content.values()
            if not isinstance(inner, dict):
                break
            content = inner
        found |= _read(content, str(file), arguments)
    for text in arguments.param:
        name, assigned, value = text.partition(":=")
        if not assigned:
            raise UsageError(f"-p {text}: must be NAME:=VALUE")
        if "." in name:
            raise UsageError(f"-p {name}: no option has a dot; keys of a scenario stand in its file (--scenario FILE)")
        found |= _read({name: parse_yaml(value, f"-p {name}")}, f"-p {name}", arguments)
    return found


def _read(content: Any, where: str, arguments: argparse.Namespace) -> dict[str, Any]:
    known = arguments.parameters
    if isinstance(content, dict):  # one text, where there may be several
        several = (name for name, value in content.items() if isinstance(value, str) and name in known)
        content |= {name: [content[name]] for name in several if known[name][0].kind is tuple}
    found = read_options(content, where, *dict.fromkeys(table for _, table in known.values()))
    if strange := next((name for name in found if name not in known), ""):
        raise UsageError(f"{where}: skd {arguments.command} has no option {strange}")
    return found


def runner_of(arguments: argparse.Namespace, *, isolated: bool = False, answer_limit: float | None = None) -> Workers:
    """Return what runs the episodes of a command in process, as the options of `add_runner_arguments` say."""
    from skd_sim.controllers.isolated import CALL_LIMIT

    from skd_evaluator.assessment.run.dask_cluster import DaskRunner
    from skd_evaluator.assessment.run.workers import InProcessRunner, available_workers

    limit = answer_limit or CALL_LIMIT
    if (address := getattr(arguments, "scheduler", None)) is not None:
        return DaskRunner(address, answer_limit=limit)
    return InProcessRunner(arguments.workers or available_workers(), isolated=isolated, answer_limit=limit)


def graph_options(arguments: argparse.Namespace) -> GraphOptions:
    """Return how to run the node graph."""
    return GraphOptions(**values_of(GraphOptions, vars(arguments)))


def result_folder(arguments: argparse.Namespace) -> ResultFolder:
    """Take the folder for the results.

    Raises:
        UsageError: it cannot be taken, or holds what the command reads.
    """
    from skd_evaluator.assessment.files.result_folder import ResultFolder
    from skd_evaluator.assessment.from_options import inputs_of, refuse_to_replace

    out = output_path(arguments)
    refuse_to_replace(out, inputs_of(vars(arguments)))
    return ResultFolder(out, overwrite=arguments.overwrite)


def output_path(arguments: argparse.Namespace) -> Path:
    """Return --out, or a new folder named for the command and the time."""
    if arguments.out is not None:
        return Path(arguments.out)
    from skd_evaluator.assessment.from_options import default_folder  # only now: it is slow to import

    return default_folder(arguments.command)

"""Command-line arguments: a verb's own options, and one flag for every leaf of a configuration.

A wrong command line is one line on stderr and exit status 2, never a page of usage. The flags and the TOML files of
`murmurate.runs.config_io` are read by the same code, so that both refuse the same values in the same words.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import dataclasses
import inspect
import re
from collections.abc import Collection, Mapping, Sequence
from itertools import zip_longest
from typing import Any, Literal, NoReturn, get_args, get_origin

from murmurate.errors import InputError, UsageError, suggestion
from murmurate.runs import config_io
from murmurate.terminal import say_text

__all__ = ["START_NAMES", "Parser", "chosen_strategies"]

START_NAMES = (
    "random, polygon, line, grid, rings, cluster, corner, wall, walls, tight-grid, scattered, distributed, packed, "
    "symmetric, surrounded, hard, or module:Class"
)
"""The starts that a word chooses, for the help: `given_starts.start_names` would load JAX."""


class Parser(argparse.ArgumentParser):
    """The arguments of one verb: `add_argument` for its own, `add_fields` for those of a configuration.

    Args:
        verb: The verb.
        positionals: Names of its positional arguments, for the usage line.
        description: What the verb does; the text of its help.
        everyday: The flags that --help shows, where there are too many for a page; --help-all shows all. None: no such
            choice.
    """

    def __init__(self, verb: str, positionals: str, description: str, everyday: Sequence[str] | None = None) -> None:
        self._everyday = everyday
        self._flags: set[str] = set()
        self._tables: dict[str, Any] = {}
        self._leaves: dict[str, config_io.Leaf] = {}
        super().__init__(
            prog=f"murmurate {verb}",
            usage=" ".join(["murmurate", verb, *positionals.split(), "[options]"]),
            description=description,
            formatter_class=_Formatter,
            allow_abbrev=False,
            exit_on_error=False,
        )
        if everyday is not None:
            self.add_argument("--help-all", action=_HelpAll, nargs=0, help="show all flags and exit")

    def add_argument(self, *names: Any, **options: Any) -> argparse.Action:
        """Adds an argument of the verb's own; see `argparse`."""
        self._flags.update(name for name in names if name.startswith("-"))
        return super().add_argument(*names, **options)

    def add_fields(self, config: Any, aliases: Mapping[str, str] | None = None, skip: Collection[str] = ()) -> None:
        """Adds a flag for every leaf of a configuration, grouped by section.

        Args:
            config: The configuration whose values are shown as the defaults.
            aliases: Short flags by the leaf's path, such as {"policy.kind": "--policy"}.
            skip: Paths of leaves that get no flag.
        """
        groups: dict[str, Any] = {}
        for leaf in config_io.leaves(config):
            if leaf.path in skip:
                continue
            section = leaf.path.rpartition(".")[0]
            if section not in groups:
                groups[section] = self.add_argument_group(section or "experiment", _summary(config, section))
            names = [alias for path, alias in (aliases or {}).items() if path == leaf.path] + [f"--{leaf.path}"]
            default = config_io.spelled(leaf.value) or "''"
            text = f"{leaf.help} (default: {default})".strip().replace("%", "%%")
            groups[section].add_argument(
                *names, dest=leaf.path, metavar=_metavar(leaf.kind), help=text, default=argparse.SUPPRESS
            )
            self._flags.update(names)
            self._leaves[leaf.path] = leaf
        self._tables.update(config_io.tables(config))

    def parse(self, argv: Sequence[str]) -> tuple[argparse.Namespace, dict[str, Any]]:
        """Reads a command line.

        Args:
            argv: The words after the verb.

        Returns:
            The verb's own arguments, and the fields that were given, as nested dictionaries for `config_io.replaced`.

        Raises:
            UsageError: A flag is unknown, or an argument is missing or too many.
            InputError: The value of a field's flag is of the wrong type.
        """
        try:
            options = self.parse_args(self._checked(argv))
        except argparse.ArgumentError as error:
            self._refuse(error)
        given = {path: vars(options).pop(path) for path in self._leaves if path in options}
        values = {path: config_io.parse(self._leaves[path].kind, text, path) for path, text in given.items()}
        return options, config_io.nested(values)

    def error(self, message: str) -> NoReturn:
        """Raises what argparse would print together with the usage."""
        raise UsageError(f"{message} (see {self.prog} --help)")

    def format_help(self, full: bool = False) -> str:
        """Returns the text of --help, or of --help-all."""
        formatter = self._get_formatter()
        formatter.add_usage(self.usage, self._actions, self._mutually_exclusive_groups)
        formatter.add_text(self.description)
        if self._everyday is None or full:
            for group in self._action_groups:
                formatter.start_section(group.title)
                formatter.add_text(group.description)
                formatter.add_arguments(group._group_actions)
                formatter.end_section()
        else:
            flags = [next(a for a in self._actions if flag in a.option_strings) for flag in self._everyday]
            formatter.start_section("arguments")
            formatter.add_arguments([*self._get_positional_actions(), *flags])
            formatter.end_section()
            formatter.add_text(f"All flags, one for every field of the configuration: {self.prog} --help-all")
        formatter.add_text(self.epilog)
        return formatter.format_help()

    def _refuse(self, error: argparse.ArgumentError) -> NoReturn:
        """Raises, in the words of this package, what argparse found wrong with the value of a flag."""
        names = (error.argument_name or "").split("/")
        action = next((action for action in self._actions if names[-1] in action.option_strings), None)
        if action is None:
            self.error(str(error))
        flag = names[-1]
        if action.nargs == 0:
            self.error(f"{flag} takes no value")
        given = re.match(r"invalid (int|float) value: (.*)", error.message)
        if given is not None:
            kind = int if given[1] == "int" else float
            raise InputError(flag, ast.literal_eval(given[2]), config_io.described(kind))
        leaf = self._leaves.get(action.dest)
        example = f", such as {flag} {_example(leaf)}" if leaf is not None else f": {flag} {action.metavar}"
        self.error(f"{flag} needs a value{example}")

    def _checked(self, argv: Sequence[str]) -> list[str]:
        """Refuses unknown flags, and ties negative values to their flags (argparse takes -1e-3 and -inf for flags)."""
        arguments: list[str] = []
        for word in argv:
            name, equals, text = word.partition("=")
            new_name = _current_name(name)
            if name not in self._flags and new_name in self._flags:
                name, word = new_name, f"{new_name}{equals}{text}"
            self._add_table_entry(name)
            if not word.startswith("-") or name in self._flags:
                arguments.append(word)
            elif _is_number(word) and arguments and arguments[-1] in self._flags:
                arguments[-1] += f"={word}"
            else:
                self.error(f"unknown flag {name}{suggestion(name, self._flags)}")
        return arguments

    def _add_table_entry(self, flag: str) -> None:
        """Adds the flag of a table's entry that is not there yet, such as --base.weights.calm."""
        path = flag.removeprefix("--")
        table, _, entry = path.rpartition(".")
        if flag not in self._flags and table in self._tables and entry.isidentifier():
            self.add_argument(flag, dest=path, help=argparse.SUPPRESS, default=argparse.SUPPRESS)
            self._leaves[path] = config_io.Leaf(path, self._tables[table], None, "")


def chosen_strategies(argv: Sequence[str], aliases: Mapping[str, str] | None = None) -> dict[str, Any]:
    """Returns the classes of strategies that a command line chooses, as nested dictionaries: their fields become flags.

    Args:
        argv: The words after the verb.
        aliases: Short flags by the leaf's path.
    """
    paths = {alias: path for path, alias in (aliases or {}).items()}
    chosen = {}
    for word, following in zip_longest(argv, argv[1:], fillvalue=""):
        name, equals, text = word.partition("=")
        path = paths.get(name, _current_name(name).removeprefix("--"))
        if name.startswith("--") and path.rpartition(".")[2] == config_io.USE:
            chosen[path] = text if equals else following
    return config_io.nested(chosen)


def _current_name(flag: str) -> str:
    """Returns the flag that version 0.1.0 spelled --start.kind as it is now: --start.use."""
    section, dot, field = flag.rpartition(".")
    return f"{section}.{config_io.USE}" if dot and field == config_io.OLD_USE else flag


class _HelpAll(argparse.Action):
    """Prints the help with all flags, and exits."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any, **__: Any) -> None:
        say_text(parser.format_help(full=True))  # type: ignore[call-arg]
        parser.exit()


def _example(leaf: config_io.Leaf) -> str:
    """Returns a value that the flag of a leaf takes: the other one where there are two, its present one elsewhere."""
    if isinstance(leaf.value, bool):
        return config_io.spelled(not leaf.value)
    return config_io.spelled(leaf.value) or _metavar(leaf.kind)


class _Formatter(argparse.HelpFormatter):
    """Help with a column wide enough for dotted flags."""

    def __init__(self, prog: str) -> None:
        super().__init__(prog, max_help_position=34)


def _is_number(word: str) -> bool:
    with contextlib.suppress(ValueError):
        float(word)
        return True
    return False


def _summary(config: Any, section: str) -> str | None:
    """Returns the first line of what a section's class says about itself."""
    for name in section.split(".") if section else ():
        config = config[name] if isinstance(config, Mapping) else getattr(config, name)
    text = inspect.getdoc(type(config)) if dataclasses.is_dataclass(config) else None
    return text.partition("\n")[0].replace("%", "%%") if text else None


def _metavar(kind: Any) -> str:
    """Names a type in the help."""
    inner, or_none = config_io.optional(kind)
    if get_origin(inner) is Literal:
        text = f"{{{','.join(get_args(inner))}}}"
    elif get_origin(inner) is tuple:
        text = ",".join("..." if item is Ellipsis else _metavar(item) for item in get_args(inner))
    else:
        text = {int: "INT", float: "NUMBER", bool: "{true,false}", str: "TEXT"}[inner]
    return f"{text}|none" if or_none else text

"""Configuration as nested frozen dataclasses: to and from plain dictionaries, TOML and the text of flags.

A field is a leaf (int, float, str, bool, a Literal of strings, one of these or None, or a tuple of them), a section,
which is another dataclass, a strategy, whose class the field `use` names, or a table of numbers or strategies by name.
Every leaf has a dotted path, such as `world.radius`, that files, flags and error messages spell in the same way. Types
are checked here; values by the dataclasses themselves when they are built. TOML has no null, so None is written as the
word "none".
"""

from __future__ import annotations

import collections.abc
import contextlib
import dataclasses
import inspect
import re
import tomllib
import types
from collections.abc import Collection, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, cast, get_args, get_origin, get_type_hints

import tomli_w

from murmurate import untrusted
from murmurate.errors import InputError, check_path, one_line, suggestion
from murmurate.registry import Importer, Strategy
from murmurate.runs import files
from murmurate.world import Start

__all__ = [
    "OLD_USE",
    "USE",
    "Leaf",
    "described",
    "dump_toml",
    "file_fields",
    "find_named",
    "from_dict",
    "is_class_name",
    "leaves",
    "load_toml",
    "located",
    "merged",
    "named",
    "nested",
    "optional",
    "parse",
    "replaced",
    "spelled",
    "strategies",
    "table_kind",
    "tables",
    "to_dict",
]

T = TypeVar("T")
S = TypeVar("S", bound=Strategy)
NONE = "none"

MAX_TOML_BYTES, MAX_KEY_PARTS = 1 << 20, 40
"""Size of a TOML file, and dots in one of its keys or numbers, at most."""

USE, OLD_USE = "use", "kind"
"""The field that names the class of a strategy, and what version 0.1.0 called it."""

_WORDS = {int: "an integer", float: "a number", bool: "true or false", str: "text"}
_READERS = {int: int, float: float, bool: {"true": True, "false": False}.__getitem__}

_RENAMED = {
    "scheduler": {
        "share": "activation_probability",
        "within": "fairness_bound",
        "delay": "max_delay",
        "span": "max_move_steps",
        "least": "min_move",
    },
    "sensing": {"unit": "unit_ratio", "missed": "miss_probability", "redrawn": "resample_frames"},
}
"""New names of the fields that version 0.1.0 called otherwise, by section."""

_DROPPED = {
    "start": {"noise", "spacing", "lines", "file"},
    "policy": {"basis", "credit"},
    "scheduler": {"activation_probability", "fairness_bound", "adversarial", "max_delay", "max_move_steps"},
}
"""Fields that version 0.1.0 wrote for every kind, by section: the classes that do not have them ignore them there."""

_REMOVED = {"rest": {"tolerance"}}
"""Fields that version 0.1.0 had, by section: they are read, and mean nothing any more."""


@dataclasses.dataclass(frozen=True)
class Leaf:
    """One leaf of a configuration.

    Attributes:
        path: Its dotted path, such as `world.radius`.
        kind: Its type.
        value: Its value in the configuration.
        help: What the docstring of its class says about it under "Attributes".
    """

    path: str
    kind: Any
    value: Any
    help: str


class LocatedText(str):
    """Text of a file, with the folder that a path in it is relative to."""

    folder: Path


def located(data: Any, folder: Path) -> Any:
    """Returns what a file in a folder holds, for `replaced` to find the files that fields of starts name."""
    if isinstance(data, Mapping):
        return {name: located(value, folder) for name, value in data.items()}
    if isinstance(data, list):
        return [located(value, folder) for value in data]
    if not isinstance(data, str):
        return data
    text = LocatedText(data)
    text.folder = folder
    return text


def to_dict(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested dictionaries; tuples become lists, and strategies name their class."""
    data: dict[str, Any] = {USE: config.name} if isinstance(config, Strategy) else {}
    return data | {name: _plain(getattr(config, name)) for name in _kinds(type(config))}


def from_dict(cls: type[T], data: Mapping[str, Any], where: str = "", importer: Importer | None = None) -> T:
    """Builds a configuration; fields that are not given have the defaults of their class.

    Args:
        cls: The dataclass to build.
        data: Nested dictionaries, as `to_dict` or TOML gives them; a section or strategy may be given built.
        where: Dotted path of this configuration inside a greater one, for error messages.
        importer: Finds the classes of strategies.

    Raises:
        InputError: A field is unknown, missing, of the wrong type, or refused by its class.
    """
    return _build(cls, None, data, where, importer or Importer())


def replaced(config: T, data: Mapping[str, Any], where: str = "", importer: Importer | None = None) -> T:
    """Returns the configuration with the fields of the nested `data` replaced and all others kept.

    A strategy whose class changes has the defaults of its new class where `data` gives nothing.

    Raises:
        InputError: A field is unknown, of the wrong type, or refused by its class.
    """
    return _build(type(config), config, data, where, importer or Importer())


def is_class_name(word: object) -> bool:
    """Returns whether a word has the form "module:Class", and is no path of a CSV file with a drive."""
    is_class = isinstance(word, str) and re.fullmatch(r"[^\W\d][\w.]*:[^\W\d][\w.]*", word)
    return bool(is_class) and not str(word).lower().endswith(".csv")


def find_named(kind: type[S], word: object, names: Collection[str], field: str, also: str = "") -> type[S] | None:
    """Returns the class that a user's word chooses, as "module:Class"; None for one of the names.

    The user names the module, so it is imported, from the working folder or the Python path.

    Args:
        kind: The kind of strategy.
        word: The word.
        names: What else it may be.
        field: What the word is for, for messages.
        also: What it may be besides, for messages.

    Raises:
        InputError: It is neither, or there is no such class of that kind.
    """
    if isinstance(word, str) and word in names:
        return None
    if not is_class_name(word):
        others = f'"module:Class", or {also}' if also else 'or "module:Class"'
        hint = suggestion(word, names) if isinstance(word, str) else ""
        raise InputError(field, word, f"one of {', '.join(names)}, {others}{hint}")
    return Importer((Path.cwd(),)).find(kind, word, field)


def named(kind: type[S], word: str, names: Collection[str], field: str) -> S:
    """Returns the strategy that a user's word chooses, with the defaults of its fields; see `find_named`.

    Args:
        kind: The kind of strategy.
        word: A registered name among the names, or "module:Class".
        names: The names that are allowed.
        field: What the word is for, for messages.

    Raises:
        InputError: There is no such strategy, or a field of it has no default.
    """
    find_named(kind, word, names, field)
    return from_dict(kind, {USE: word}, field, Importer((Path.cwd(),)))


def merged(first: Mapping[str, Any], *later: Mapping[str, Any]) -> dict[str, Any]:
    """Returns nested dictionaries merged; later ones win, field by field."""
    result = dict(first)
    for data in later:
        for name, value in data.items():
            old = result.get(name)
            if isinstance(old, Mapping) and isinstance(value, Mapping):
                value = _merged_tables(old, value)
            result[name] = value
    return result


def _merged_tables(old: Mapping[str, Any], new: Mapping[str, Any]) -> Mapping[str, Any]:
    """Merges two tables; where the later one names another class of strategy, nothing is left of the earlier one."""
    old_use, new_use = (table.get(USE, table.get(OLD_USE)) for table in (old, new))
    if None in (old_use, new_use):
        return merged(old, new)
    if old_use != new_use:
        return new
    key = OLD_USE if OLD_USE in old or OLD_USE in new else USE
    tables = ({name: value for name, value in table.items() if name not in (USE, OLD_USE)} for table in (old, new))
    return {key: new_use, **merged(*tables)}


def nested(values: Mapping[str, Any]) -> dict[str, Any]:
    """Returns values by dotted path as nested dictionaries."""
    result: dict[str, Any] = {}
    for path, value in values.items():
        *sections, name = path.split(".")
        inner = result
        for section in sections:
            inner = inner.setdefault(section, {})
        inner[name] = value
    return result


def leaves(config: Any, where: str = "") -> Iterator[Leaf]:
    """Yields the leaves of a configuration in the order of its fields, depth first."""
    texts = _attribute_texts(type(config))
    if isinstance(config, Strategy):
        names = ", ".join(config.registered())
        yield Leaf(_join(where, USE), str, config.name, f'One of {names}, or "module:Class" of one\'s own.')
    for name, kind in _kinds(type(config)).items():
        value, path = getattr(config, name), _join(where, name)
        table = table_kind(kind)
        if table is not None:
            for key, entry in value.items():
                if _is_section(table):
                    yield from leaves(entry, _join(path, key))
                else:
                    yield Leaf(_join(path, key), table, entry, texts.get(name, ""))
        elif _is_section(kind):
            yield from leaves(value, path)
        else:
            yield Leaf(path, kind, value, texts.get(name, ""))


def tables(config: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yields the dotted path and the type of the entries of every table of numbers or texts by name."""
    for name, kind in _kinds(type(config)).items():
        path, table = _join(where, name), table_kind(kind)
        if table is not None and not _is_section(table):
            yield path, table
        elif table is None and _is_section(kind):
            yield from tables(getattr(config, name), path)


def strategies(config: Any, where: str = "") -> Iterator[tuple[str, Strategy]]:
    """Yields the strategies of a configuration with their dotted paths, nested ones too."""
    if isinstance(config, Strategy):
        yield where, config
    for name, kind in _kinds(type(config)).items():
        value, path, table = getattr(config, name), _join(where, name), table_kind(kind)
        if table is not None and _is_section(table):
            for key, entry in value.items():
                yield from strategies(entry, _join(path, key))
        elif table is None and _is_section(kind):
            yield from strategies(value, path)


def file_fields(start: Start, where: str = "start") -> dict[str, str]:
    """Returns the files that a start, and the starts in it, name by the dotted paths of their fields.

    Raises:
        InputError: A class lists a field that it does not have, or that holds no text.
    """
    found: dict[str, str] = {}
    for path, part in strategies(start, where):
        for name in part.file_fields if isinstance(part, Start) else ():
            value = getattr(part, name, None)
            if not isinstance(value, str):
                raise InputError(_join(path, name), value, f"a field of text: {part.name} lists it in file_fields")
            if value:
                found[_join(path, name)] = value
    return found


def parse(kind: Any, text: str, path: str) -> Any:
    """Reads a leaf from text; the items of a tuple are separated by commas.

    Args:
        kind: The leaf's type.
        text: What the user wrote.
        path: The leaf's dotted path, for error messages.

    Raises:
        InputError: The text is not a value of that type.
    """
    inner, or_none = optional(kind)
    if or_none and text == NONE:
        return None
    if get_origin(inner) is tuple:
        items = [item.strip() for item in text.split(",")] if text.strip() else []
        try:
            return tuple(parse(item_kind, item, path) for item_kind, item in _items(inner, items, text, path))
        except InputError:
            raise InputError(path, text, _described_text(kind)) from None
    value: Any = text
    with contextlib.suppress(KeyError, ValueError):  # text that cannot be read stays text, which is then refused
        value = _READERS.get(inner, str)(text)
    try:
        return _converted(inner, value, path)
    except InputError:
        if inner not in (int, float) or "," not in text:
            raise
        example = text.replace(",", ".") if inner is float and text.count(",") == 1 else text.replace(",", "")
        raise InputError(path, text, f"{described(kind)} without commas, such as {example}") from None


def _described_text(kind: Any) -> str:
    """Returns in words how the items of a tuple are written in a flag."""
    inner, or_none = optional(kind)
    items = get_args(inner)
    examples = {int: ("32", "16"), float: ("0.5", "1.5"), bool: ("true", "false"), str: ("a", "b")}
    if items[-1] is Ellipsis:
        what, items = f"{described(items[0]).removeprefix('an ').removeprefix('a ')}s", (items[0],) * 2
    else:
        what = f"{len(items)} values"
    example = ",".join(examples.get(item, get_args(item))[index % 2] for index, item in enumerate(items))
    return f"{what}, separated by commas, such as {example}" + (f", or {NONE}" if or_none else "")


def spelled(value: Any) -> str:
    """Writes a leaf's value as its flag takes it: what `parse` reads."""
    if isinstance(value, tuple):
        return ",".join(map(spelled, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def load_toml(path: str | Path, follow: bool = True) -> dict[str, Any]:
    """Reads a TOML file, which may be a stranger's.

    Args:
        path: The file.
        follow: Whether it may be a link: for files that the user names, not for those of a run.

    Raises:
        InputError: The file is not valid TOML, or nests too deep; the message names the line.
        OSError: The file cannot be read, or is too large.
    """
    check_path("path", path)
    try:
        text = untrusted.read(path, MAX_TOML_BYTES, follow).decode("utf-8-sig")
        # tomllib takes a time that grows with the square of the parts of a key.
        if any(piece.count(".") > MAX_KEY_PARTS for piece in re.split(r"[=,{}\[\]\n\"']", text)):
            raise ValueError(f"a key has more than {MAX_KEY_PARTS} parts")
        data = tomllib.loads(text)
        files.check_plain(data)
        return data
    except RecursionError:
        raise InputError("configuration file", str(path), "valid TOML: it nests too deep") from None
    except ValueError as error:  # TOMLDecodeError and UnicodeDecodeError are ones, and so is Python's of long integers
        raise InputError("configuration file", str(path), f"valid TOML: {one_line(str(error), 100)}") from None


def dump_toml(config: Any) -> str:
    """Returns a configuration as TOML, every field written out; `from_dict` gives back an equal configuration."""

    def written(value: Any) -> Any:
        if isinstance(value, dict):
            return {name: written(inner) for name, inner in value.items()}
        if isinstance(value, list):
            return [written(item) for item in value]
        return NONE if value is None else value

    return tomli_w.dumps(written(to_dict(config)))


def optional(kind: Any) -> tuple[Any, bool]:
    """Splits the type `X | None` into X and True; any other type is returned with False."""
    if get_origin(kind) in (Union, types.UnionType):
        kinds = [inner for inner in get_args(kind) if inner is not type(None)]
        if len(kinds) == 1:
            return kinds[0], True
    return kind, False


def table_kind(kind: Any) -> Any:
    """Returns the type of the entries of a table by name; None for any other type."""
    return get_args(kind)[1] if get_origin(kind) is collections.abc.Mapping else None


def _build(cls: Any, current: Any, data: Any, where: str, importer: Importer) -> Any:
    """Builds a section or strategy from data, the rest from `current` or, without that, from the class's defaults."""
    if isinstance(data, cls):
        return data
    if issubclass(cls, Strategy):
        data = {USE: data} if isinstance(data, str) else data
        _check_table(cls, data, where)
        cls, data = _chosen(cls, current, dict(data), where, importer)
        current = current if type(current) is cls else None
    _check_table(cls, data, where)
    kinds = _kinds(cls)
    values: dict[str, Any] = {}
    for name, value in data.items():
        path = _join(where, name)
        if name not in kinds and name in _REMOVED.get(where, ()):
            continue
        if name not in kinds:
            raise InputError(path, value, f"a field of {_known(cls, where)}{suggestion(name, kinds)}")
        if issubclass(cls, Start) and name in cls.file_fields and isinstance(value, LocatedText) and value:
            value = str(value.folder / value)
        values[name] = _field(kinds[name], getattr(current, name, None), value, path, importer)
    try:
        if current is not None:
            return dataclasses.replace(current, **values)
        for field in dataclasses.fields(cls):
            if field.name not in values and field.default is field.default_factory is dataclasses.MISSING:
                raise InputError(field.name, None, f"given ({described(kinds[field.name])})")
        return cls(**values)
    except InputError as error:
        raise InputError(_join(where, error.field), error.value, error.allowed) from None


def _field(kind: Any, current: Any, value: Any, path: str, importer: Importer) -> Any:
    """Returns the value of one field, as its class wants it."""
    table = table_kind(kind)
    if table is not None:
        if not isinstance(value, Mapping):
            raise InputError(path, value, "a table by name")
        entries = dict(current or {})
        for key, entry in value.items():
            entry_path, old = _join(path, key), entries.get(key)
            if not _is_section(table):
                entries[key] = _converted(table, entry, entry_path)
                continue
            if old is None and isinstance(entry, Mapping) and not entry.keys() & {USE, OLD_USE}:
                # A signal of this package needs no `use`: its name says it.
                entry = {USE: key, **entry}
            entries[key] = _build(table, old, entry, entry_path, importer)
        return entries
    if _is_section(kind):
        return _build(kind, current, value, path, importer)
    return _converted(kind, value, path)


def _chosen(
    kind: Any, current: Any, data: dict[str, Any], where: str, importer: Importer
) -> tuple[type[Strategy], dict[str, Any]]:
    """Returns the class of a strategy, and the fields that are given for it."""
    if USE in data and OLD_USE in data and OLD_USE not in _all_names(kind):
        raise InputError(_join(where, OLD_USE), data[OLD_USE], f"left out: {_join(where, USE)} says it")
    is_old = USE not in data and OLD_USE in data
    use = data.pop(USE, data.pop(OLD_USE, None) if is_old else None)
    if use is None:
        if current is None:
            names = ", ".join(kind.registered())
            raise InputError(_join(where, USE), None, f'given: one of {names}, or "module:Class"')
        return type(current), data
    strategy = importer.find(kind, use, _join(where, USE))
    if is_old:
        renamed = _RENAMED.get(kind.section, {})
        data = {renamed.get(name, name): value for name, value in data.items()}
        unused = _DROPPED.get(kind.section, set()) - _kinds(strategy).keys()
        data = {name: value for name, value in data.items() if name not in unused}
    return strategy, data


def _all_names(kind: Any) -> set[str]:
    return {name for strategy in kind.registered().values() for name in _kinds(strategy)}


def _check_table(cls: Any, data: Any, where: str) -> None:
    if not isinstance(data, Mapping):
        raise InputError(where or "configuration", data, f"a table with fields of {_known(cls, where)}")


def _known(cls: Any, where: str) -> str:
    names = ([USE] if issubclass(cls, Strategy) else []) + list(_kinds(cls))
    return f"{f'[{where}]' if where else 'the configuration'} ({', '.join(names)})"


def _converted(kind: Any, value: Any, path: str) -> Any:
    """Returns the value as the leaf's type wants it: numbers for float fields become floats, lists become tuples."""
    inner, or_none = optional(kind)
    value = str(value) if isinstance(value, LocatedText) else value
    if or_none and value in (None, NONE):
        return None
    if get_origin(inner) is tuple and isinstance(value, list | tuple):
        return tuple(_converted(item_kind, item, path) for item_kind, item in _items(inner, value, value, path))
    if inner is float and type(value) is int:
        with contextlib.suppress(OverflowError):
            value = float(value)
    if value not in get_args(inner) if get_origin(inner) is Literal else type(value) is not inner:
        raise InputError(path, value, described(kind))
    return value


def _items(kind: Any, items: Sequence[Any], given: Any, path: str) -> list[tuple[Any, Any]]:
    """Pairs the items of a tuple with their types."""
    kinds = get_args(kind)
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(items)
    if len(kinds) != len(items):
        raise InputError(path, given, described(kind))
    return list(zip(kinds, items, strict=True))


def _plain(value: Any) -> Any:
    if dataclasses.is_dataclass(value):
        return to_dict(value)
    if isinstance(value, Mapping):
        return {name: _plain(entry) for name, entry in value.items()}
    return [_plain(item) for item in value] if isinstance(value, tuple) else value


def described(kind: Any) -> str:
    """Returns in words what a type allows."""
    inner, or_none = optional(kind)
    if _is_section(inner) or table_kind(inner) is not None:
        text = "a table"
    elif get_origin(inner) is Literal:
        text = f"one of {', '.join(get_args(inner))}"
    elif get_origin(inner) is tuple:
        text = f"a list [{', '.join('...' if item is Ellipsis else described(item) for item in get_args(inner))}]"
    else:
        text = _WORDS[inner]
    return f"{text} or {NONE}" if or_none else text


@cache
def _kinds(cls: Any) -> dict[str, Any]:
    """Returns the types of a dataclass's fields by name, in order."""
    try:
        hints = get_type_hints(cls)
    except Exception as error:  # a user's annotations may refer to anything
        raise InputError(cls.__name__, "its annotations", f"types that can be resolved ({error})") from None
    kinds = {field.name: hints[field.name] for field in dataclasses.fields(cls)}
    for name, kind in kinds.items():
        table = table_kind(kind)
        if not (_is_leaf(kind) or _is_section(kind) or (table is not None and (_is_leaf(table) or _is_section(table)))):
            shown = getattr(kind, "__name__", kind)
            allowed = "int, float, str, bool, a Literal of strings, a tuple of these, or one of these or None"
            raise InputError(f"{cls.__name__}.{name}", str(shown), f"a type that a configuration can hold: {allowed}")
    return kinds


def _is_section(kind: Any) -> bool:
    return inspect.isclass(kind) and dataclasses.is_dataclass(kind)


def _is_leaf(kind: Any) -> bool:
    inner, _ = optional(kind)
    if get_origin(inner) is tuple:
        return all(item is Ellipsis or _is_leaf(item) for item in get_args(inner))
    return inner in _WORDS or get_origin(inner) is Literal


@cache
def _attribute_texts(cls: type) -> dict[str, str]:
    """Returns the text about each field under "Attributes:" in the docstrings of a class and its bases, on one line."""
    texts: dict[str, str] = {}
    for base in reversed(cls.__mro__):
        if not dataclasses.is_dataclass(base):
            continue
        _, _, part = inspect.cleandoc(base.__doc__ or "").partition("Attributes:\n")
        part = re.split(r"\n(?=\S)", part)[0]
        entries = re.findall(r"^ {4}(\w+)(?: \(.*?\))?: (.*(?:\n {5,}.*)*)", part, flags=re.MULTILINE)
        texts.update((name, " ".join(text.split())) for name, text in entries)
    return cast(dict[str, str], texts)


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name

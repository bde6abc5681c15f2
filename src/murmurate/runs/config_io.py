"""Configuration as nested frozen dataclasses: to and from plain dictionaries, TOML and the text of flags.

A field is a section, which is another dataclass, or a leaf: int, float, str, bool, a Literal of strings, one of these
or None, or a tuple of them. Every leaf has a dotted path, such as `world.radius`, that files, flags and error messages
spell alike. Types are checked here; values by the dataclasses themselves, in `__post_init__`. TOML has no null, so None
is written as the word "none".
"""

from __future__ import annotations

import contextlib
import dataclasses
import inspect
import re
import tomllib
import types
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import tomli_w

from murmurate.errors import InputError, suggestion

__all__ = [
    "Leaf",
    "dump_toml",
    "from_dict",
    "leaves",
    "load_toml",
    "merged",
    "nested",
    "optional",
    "parse",
    "replaced",
    "spelled",
    "to_dict",
]

T = TypeVar("T")
NONE = "none"
_WORDS = {int: "an integer", float: "a number", bool: "true or false", str: "text"}
_READERS = {int: int, float: float, bool: {"true": True, "false": False}.__getitem__}


@dataclasses.dataclass(frozen=True)
class Leaf:
    """One leaf of a configuration.

    Attributes:
        path: Its dotted path, such as `world.radius`.
        kind: Its type.
        value: Its value in the configuration at hand.
        help: What its class says about it under "Attributes".
    """

    path: str
    kind: Any
    value: Any
    help: str


def to_dict(config: Any) -> dict[str, Any]:
    """Returns a configuration as nested dictionaries; tuples become lists."""

    def plain(value: Any) -> Any:
        if dataclasses.is_dataclass(value):
            return to_dict(value)
        return [plain(item) for item in value] if isinstance(value, tuple) else value

    return {field.name: plain(getattr(config, field.name)) for field in dataclasses.fields(config)}


def from_dict(cls: type[T], data: Mapping[str, Any], where: str = "") -> T:
    """Builds a configuration; fields that are not given have the defaults of their class.

    Args:
        cls: The dataclass to build.
        data: Nested dictionaries, as `to_dict` or TOML gives them.
        where: Dotted path of this configuration inside a greater one, for error messages.

    Raises:
        InputError: A field is unknown, missing, of the wrong type, or refused by its dataclass.
    """
    return _made(cls, None, data, where)


def replaced(config: T, data: Mapping[str, Any], where: str = "") -> T:
    """Returns the configuration with the fields of the nested `data` replaced and all others kept.

    Raises:
        InputError: A field is unknown, of the wrong type, or refused by its dataclass.
    """
    return _made(type(config), config, data, where)


def merged(first: Mapping[str, Any], *later: Mapping[str, Any]) -> dict[str, Any]:
    """Returns nested dictionaries merged; later ones win, field by field."""
    result = dict(first)
    for data in later:
        for name, value in data.items():
            old = result.get(name)
            if isinstance(old, Mapping) and isinstance(value, Mapping):
                value = merged(old, value)
            result[name] = value
    return result


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
    for name, kind in _kinds(type(config)).items():
        value, path = getattr(config, name), _join(where, name)
        if dataclasses.is_dataclass(kind):
            yield from leaves(value, path)
        else:
            yield Leaf(path, kind, value, texts.get(name, ""))


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
        return tuple(parse(item_kind, item, path) for item_kind, item in _items(inner, items, text, path))
    value: Any = text
    with contextlib.suppress(KeyError, ValueError):  # text that cannot be read stays text, which is then refused
        value = _READERS.get(inner, str)(text)
    return _converted(inner, value, path)


def spelled(value: Any) -> str:
    """Writes a leaf's value as its flag takes it: what `parse` reads."""
    if isinstance(value, tuple):
        return ",".join(map(spelled, value))
    return str(value).lower() if value is None or isinstance(value, bool) else str(value)


def load_toml(path: str | Path) -> dict[str, Any]:
    """Reads a TOML file.

    Raises:
        InputError: The file is not valid TOML; the message names the line.
        OSError: The file cannot be read.
    """
    try:
        return tomllib.loads(Path(path).read_bytes().decode())
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError("configuration file", str(path), f"valid TOML: {error}") from None


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


def _made(cls: Any, current: Any, data: Mapping[str, Any], where: str) -> Any:
    """Builds `cls` from data, the rest from `current`, or when that is None from the defaults of the class."""
    kinds = _kinds(cls)
    known = f"{f'[{where}]' if where else 'the configuration'} ({', '.join(kinds)})"
    if not isinstance(data, Mapping):
        raise InputError(where or "configuration", data, f"a table with fields of {known}")
    values: dict[str, Any] = {}
    for name, value in data.items():
        path = _join(where, name)
        if name not in kinds:
            raise InputError(path, value, f"a field of {known}{suggestion(name, kinds)}")
        if dataclasses.is_dataclass(kinds[name]):
            values[name] = _made(kinds[name], getattr(current, name, None), value, path)
        else:
            values[name] = _converted(kinds[name], value, path)
    try:
        if current is not None:
            return dataclasses.replace(current, **values)
        for field in dataclasses.fields(cls):
            if field.name not in values and field.default is field.default_factory is dataclasses.MISSING:
                raise InputError(field.name, None, f"given ({_described(kinds[field.name])})")
        return cls(**values)
    except InputError as error:
        raise InputError(_join(where, error.field), error.value, error.allowed) from None


def _converted(kind: Any, value: Any, path: str) -> Any:
    """Returns the value as the leaf's type wants it: numbers for float fields become floats, lists become tuples."""
    inner, or_none = optional(kind)
    if or_none and value in (None, NONE):
        return None
    if get_origin(inner) is tuple and isinstance(value, list | tuple):
        return tuple(_converted(item_kind, item, path) for item_kind, item in _items(inner, value, value, path))
    if inner is float and type(value) is int:
        with contextlib.suppress(OverflowError):
            value = float(value)
    if value not in get_args(inner) if get_origin(inner) is Literal else type(value) is not inner:
        raise InputError(path, value, _described(kind))
    return value


def _items(kind: Any, items: Sequence[Any], given: Any, path: str) -> list[tuple[Any, Any]]:
    """Pairs the items of a tuple with their types."""
    kinds = get_args(kind)
    if kinds[-1] is Ellipsis:
        kinds = kinds[:1] * len(items)
    if len(kinds) != len(items):
        raise InputError(path, given, _described(kind))
    return list(zip(kinds, items, strict=True))


def _described(kind: Any) -> str:
    """Says in words what a type allows."""
    inner, or_none = optional(kind)
    if dataclasses.is_dataclass(inner):
        text = "a table"
    elif get_origin(inner) is Literal:
        text = f"one of {', '.join(get_args(inner))}"
    elif get_origin(inner) is tuple:
        text = f"a list [{', '.join('...' if item is Ellipsis else _described(item) for item in get_args(inner))}]"
    else:
        text = _WORDS[inner]
    return f"{text} or {NONE}" if or_none else text


@cache
def _kinds(cls: Any) -> dict[str, Any]:
    """Returns the types of a dataclass's fields by name, in order."""
    hints = get_type_hints(cls)
    kinds = {field.name: hints[field.name] for field in dataclasses.fields(cls)}
    for name, kind in kinds.items():
        if not (dataclasses.is_dataclass(kind) or _is_leaf(kind)):
            raise TypeError(f"{cls.__name__}.{name}: a configuration field cannot be {kind}")
    return kinds


def _is_leaf(kind: Any) -> bool:
    inner, _ = optional(kind)
    if get_origin(inner) is tuple:
        return all(item is Ellipsis or _is_leaf(item) for item in get_args(inner))
    return inner in _WORDS or get_origin(inner) is Literal


@cache
def _attribute_texts(cls: type) -> dict[str, str]:
    """Returns what the "Attributes:" part of a class's docstring says about each field, each on one line."""
    _, _, part = inspect.cleandoc(cls.__doc__ or "").partition("Attributes:\n")
    part = re.split(r"\n(?=\S)", part)[0]
    entries = re.findall(r"^ {4}(\w+)(?: \(.*?\))?: (.*(?:\n {5,}.*)*)", part, flags=re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in entries}


def _join(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name

"""The `repr` of what users hold: one short line, whatever is in it."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

__all__ = ["short_repr"]

MAX_LINE = 200
"""Characters of a line, at most."""

MAX_TEXT = 60
"""Characters of a value that has no fields, at most."""

MAX_ITEMS = 4
"""Elements of a sequence or an array that are written one by one, at most; more of an array are its type and shape."""


def short_repr(self: Any) -> str:
    """Returns an object's class and those of its fields that differ from their defaults, on one short line.

    A class becomes one with such lines by `__repr__ = short_repr`. (One that it inherits would be replaced by that of
    `@dataclass`, and a named tuple inherits from nothing else.) Its fields are those of a dataclass, of an Equinox
    module or of a named tuple; a class of another kind names them in `__match_args__`. Flags are counted, and of large
    arrays only the type and the shape are written. Where the line would be too long, objects in the fields are written
    without theirs, and the last fields are left out.
    """
    name = type(self).__name__
    parts = list(_parts(self, _nested))
    if _length(name, parts) > MAX_LINE:
        parts = list(_parts(self, _without_fields))
    if _length(name, parts) > MAX_LINE:
        parts.append("...")
        while _length(name, parts) > MAX_LINE:
            parts.pop(-2)
    return f"{name}({', '.join(parts)})"


def _length(name: str, parts: list[str]) -> int:
    return len(name) + len(", ".join(parts)) + len("()")


def _parts(instance: Any, nested: Callable[[Any], str]) -> Iterator[str]:
    for name, default in _fields(instance):
        value = getattr(instance, name, dataclasses.MISSING)
        if value is dataclasses.MISSING:  # an object that was refused before it was complete
            continue
        text = _text(value, nested)
        if default is dataclasses.MISSING or text != _text(default, nested):
            yield f"{name}={text}"


def _fields(instance: Any) -> Iterable[tuple[str, Any]]:
    """Returns the names of an object's fields with their defaults."""
    if dataclasses.is_dataclass(instance):
        fields = (field for field in dataclasses.fields(instance) if field.repr)
        return ((field.name, _default(field)) for field in fields)
    if isinstance(instance, tuple):
        names, defaults = getattr(instance, "_fields", ()), getattr(instance, "_field_defaults", {})
        return ((name, defaults.get(name, dataclasses.MISSING)) for name in names)
    return ((name, dataclasses.MISSING) for name in instance.__match_args__)


def _default(field: dataclasses.Field[Any]) -> Any:
    return field.default if field.default_factory is dataclasses.MISSING else field.default_factory()


def _has_fields(value: Any) -> bool:
    return dataclasses.is_dataclass(value) or hasattr(value, "_fields") or type(value).__repr__ is short_repr


def _nested(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= MAX_LINE and "\n" not in text else short_repr(value)


def _without_fields(value: Any) -> str:
    return f"{type(value).__name__}(...)"


def _text(value: Any, nested: Callable[[Any], str]) -> str:
    if isinstance(value, type):
        return value.__name__
    if hasattr(value, "dtype") and hasattr(value, "shape"):
        return _array(value)
    if isinstance(value, float):
        return repr(float(f"{value:.6g}"))
    if isinstance(value, bytes):
        return f"{len(value)} bytes"
    if isinstance(value, Mapping):
        return f"{{{_listed((f'{key!r}: {_text(item, nested)}' for key, item in value.items()), len(value))}}}"
    if _has_fields(value):
        return nested(value)
    if isinstance(value, list | tuple):
        items = _listed((_text(item, nested) for item in value), len(value))
        return f"[{items}]" if isinstance(value, list) else f"({items}{',' * (len(value) == 1)})"
    if callable(value):
        return getattr(value, "__name__", type(value).__name__)
    text = " ".join(repr(value).split())
    return text if len(text) <= MAX_TEXT else f"{text[: MAX_TEXT - 3]}..."


def _listed(items: Iterator[str], count: int) -> str:
    shown = [item for _, item in zip(range(MAX_ITEMS), items, strict=False)]
    return ", ".join([*shown, "..."] if count > MAX_ITEMS else shown)


def _array(value: Any) -> str:
    shape = f"{value.dtype}[{', '.join(map(str, value.shape))}]"
    try:
        if value.dtype == bool and value.shape:
            return f"{np.count_nonzero(np.asarray(value))} of {value.size}"
        if value.size > MAX_ITEMS:
            return shape
        return _rounded(np.asarray(value).tolist())
    except Exception:  # numbers that are not known yet, or no longer: in a program that is traced, on other devices
        return shape


def _rounded(value: Any) -> str:
    if isinstance(value, list):
        return f"[{', '.join(map(_rounded, value))}]"
    return repr(float(f"{value:.6g}")) if isinstance(value, float) else repr(value)

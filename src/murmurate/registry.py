"""Strategies: the parts of an experiment that users can replace by classes of their own.

Each kind of strategy is an abstract class, such as `Signal` or `Start`. A configuration chooses one of its subclasses
by a registered name or as "module:Class"; the dataclass fields of the class are the configuration's fields. The
strategies of this package are registered in the same way as a user's.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import importlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any, ClassVar, TypeVar

import equinox as eqx

from murmurate.errors import InputError, suggestion
from murmurate.representation import short_repr

__all__ = ["Importer", "Strategy"]

S = TypeVar("S", bound="Strategy")

_registered: dict[type, dict[str, type[Strategy]]] = {}
_spellings: dict[type, str] = {}
"""How a configuration spells a class that an `Importer` has imported."""


class Strategy(eqx.Module):
    """Base of all strategies.

    A direct subclass defines a kind; subclasses of a kind are the strategies of that kind. Fields that hold numbers are
    leaves of the PyTree; a field that changes shapes or control flow is declared with `eqx.field(static=True)`.
    """

    section: ClassVar[str] = "strategy"
    """What the kind is called in configurations and messages."""

    __repr__ = short_repr

    @classmethod
    def strategy_kind(cls) -> type[Strategy]:
        """Returns the kind of this strategy, such as `Start`."""
        return next(base for base in cls.__mro__ if Strategy in base.__bases__)

    @classmethod
    def register(cls, name: str) -> Callable[[type[S]], type[S]]:
        """Returns a class decorator that registers a strategy of this kind under a name.

        Args:
            name: The name by which configurations choose the class.

        Raises:
            InputError: Another class has that name, or the name contains a colon.
        """
        table = _registered.setdefault(cls.strategy_kind(), {})

        def decorate(strategy: type[S]) -> type[S]:
            known = table.get(name)
            # A module that is executed again, as in a notebook, may register its class again.
            if known is not None and _identity(known) != _identity(strategy):
                raise InputError(cls.section, name, f"a new name: {known.__qualname__} is registered under it")
            if not name or ":" in name:
                raise InputError(cls.section, name, "a name without a colon")
            table[name] = strategy
            return strategy

        return decorate

    @classmethod
    def registered(cls) -> dict[str, type[Strategy]]:
        """Returns the registered strategies of this kind by name."""
        return dict(_registered.get(cls.strategy_kind(), {}))

    @classmethod
    def spelling(cls) -> str:
        """Returns what a configuration calls this class: its registered name, or "module:Class" for a user's class."""
        if cls.is_foreign():
            return _spellings.get(cls, f"{cls.__module__}:{cls.__qualname__}")
        return next(name for name, strategy in cls.registered().items() if strategy is cls)

    @classmethod
    def is_foreign(cls) -> bool:
        """Returns whether this class is not part of the package."""
        return cls not in cls.registered().values() or cls.__module__.partition(".")[0] != __package__

    @property
    def name(self) -> str:
        """What a configuration calls the class of this strategy."""
        return type(self).spelling()


@dataclasses.dataclass(frozen=True)
class Importer:
    """Finds the class of a strategy that a configuration names.

    Attributes:
        folders: Folders in which modules are looked for before the Python path.
        trusted: Whether modules from outside the package may be imported: importing one executes it. Classes that this
            process has imported already are always found.
    """

    folders: tuple[Path, ...] = ()
    trusted: bool = True

    __repr__ = short_repr

    def find(self, kind: type[S], use: object, field: str) -> type[S]:
        """Returns the class that a configuration names.

        Args:
            kind: The kind of strategy.
            use: A registered name or "module:Class".
            field: The field that names it, for messages.

        Raises:
            InputError: There is no such class, it is not a strategy of that kind, or it may not be imported.
        """
        known = kind.registered()
        if isinstance(use, str) and use in known:
            return known[use]  # type: ignore[return-value]
        module, colon, attribute = use.partition(":") if isinstance(use, str) else ("", "", "")
        if not (module and colon and attribute):
            names = ", ".join(known)
            hint = suggestion(use, known) if isinstance(use, str) else ""
            raise InputError(field, use, f'one of {names}, or "module:Class"{hint}')
        wanted = f"a class murmurate.{kind.__name__} as module:Class"
        if not self.trusted:
            # Nothing is executed to find a class of a module that this process has imported already.
            loaded = getattr(sys.modules.get(module), attribute, None)
            for imported in (*(cls for cls, spelling in _spellings.items() if spelling == use), loaded):
                if inspect.isclass(imported) and issubclass(imported, kind):
                    return imported
            allowed = "trusted before it is imported: load(run, trust=True), or --trust"
            raise InputError(field, use, f"{allowed} ({wanted})")
        try:
            target: Any = self._module(module)
            for part in attribute.split("."):
                target = getattr(target, part)
        except Exception as error:  # a user's module may raise anything
            raise InputError(field, use, f"{wanted} that can be imported ({type(error).__name__}: {error})") from None
        if not (inspect.isclass(target) and issubclass(target, kind)):
            raise InputError(field, use, f"{wanted}; this is no subclass of it")
        missing = getattr(target, "__abstractmethods__", frozenset())
        if missing:
            raise InputError(field, use, f"{wanted}; this one lacks {', '.join(sorted(missing))}")
        _spellings[target] = str(use)
        return target

    def _module(self, name: str) -> ModuleType:
        for folder in self.folders:
            path = folder / Path(*name.split(".")).with_suffix(".py")
            if path.is_file():
                return _load(name, path.resolve())
        return importlib.import_module(name)


def _identity(strategy: type) -> tuple[str, str]:
    return strategy.__module__, strategy.__qualname__


def source_folder(strategy: type[Strategy]) -> str | None:
    """Returns the folder from which the module of a user's strategy can be imported again; None where there is none."""
    file = getattr(sys.modules.get(strategy.__module__), "__file__", None)
    if file is None or strategy.__module__ == "__main__":
        return None
    return str(Path(file).resolve().parents[strategy.spelling().partition(":")[0].count(".")])


def _load(name: str, path: Path) -> ModuleType:
    """Imports a module from a file; files of the same name in different folders become different modules."""
    loaded = sys.modules.get(name)
    if loaded is not None and getattr(loaded, "__file__", None) and Path(str(loaded.__file__)).resolve() == path:
        return loaded
    unique = name if loaded is None else f"{name}@{hashlib.sha256(str(path).encode()).hexdigest()[:12]}"
    if unique in sys.modules:
        return sys.modules[unique]
    spec = importlib.util.spec_from_file_location(unique, path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python module")
    module = importlib.util.module_from_spec(spec)
    sys.modules[unique] = module
    try:
        with _on_path(path.parent):
            spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[unique]
        raise
    return module


@contextlib.contextmanager
def _on_path(folder: Path) -> Iterator[None]:
    """Lets a module import its neighbours while it is executed."""
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))

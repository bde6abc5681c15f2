"""The command `murmurate`: finds the verb, runs it, and turns what goes wrong into one line and an exit status.

Exit status: 0 done, 2 bad input or an unusable run folder, 3 no valid pattern was discovered, 4 runs of a sweep failed,
5 fewer valid patterns than `discovery.required_valid` asks for, 130 interrupted.
"""

from __future__ import annotations

import contextlib
import importlib
import io
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from murmurate import __version__
from murmurate.errors import (
    MAX_LINE,
    BeyondTrainingWarning,
    InputError,
    RunError,
    StartSetWarning,
    UsageError,
    one_line,
    suggestion,
)
from murmurate.interrupts import sigterm_as_interrupt
from murmurate.terminal import say, say_text

__all__ = ["FAILED", "NOTHING_VALID", "STATUS", "TOO_FEW_VALID", "main"]

BAD_INPUT = 2
NOTHING_VALID = 3
FAILED = 4
TOO_FEW_VALID = 5
INTERRUPTED = 130  # what a shell reports for a process that SIGINT ended
BROKEN_PIPE = 141  # and for one that SIGPIPE ended

STATUS = (
    f"Exit status: 0 done, {BAD_INPUT} bad input, {NOTHING_VALID} no valid pattern was discovered, {TOO_FEW_VALID} "
    "fewer of them than discovery.required_valid asks for."
)

# Each verb is a module of this package with `run(argv) -> int`, imported only when it is called for.
VERBS = {
    "discover": "train the policies of an experiment and show the pattern that they form",
    "sweep": "train many runs, on all cores, Ray or Slurm, and write one table of them",
    "evaluate": "run a discovered cascade from fresh starts, a set of starts or a file",
    "show": "draw the figures and the animation of a run",
    "catalogue": "sort what runs found into classes of patterns, and draw them on a plate",
    "optimum": "search for the best formation there is, or list the best known",
    "experiments": "list the experiments",
    "compare": "run learned policies and baselines from the same starts, with the same sensing and schedulers",
    "starts": "write a named set of starts, the same on every machine, or list the sets",
    "table": "write the results of many runs as a Markdown table",
    "export": "write policies as an ONNX model, or trajectories as waypoints in metres",
    "reproduce": "train everything, and write a report of the paper's tables and figures beside ours",
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Args:
        argv: The words after `murmurate`; those of the process by default.

    Returns:
        The exit status. Errors that a user can cause are one line on stderr; any other exception is a defect and rises.
    """
    with _replacing_characters():
        return _main(list(sys.argv[1:] if argv is None else argv))


def _main(arguments: list[str]) -> int:
    try:
        with sigterm_as_interrupt():
            status = _run(arguments)
        sys.stdout.flush()
        return status
    except (InputError, RunError, UsageError) as error:
        return _complain(str(error), BAD_INPUT)
    except BrokenPipeError:
        # The reader of the pipe has closed it. Python flushes once more at exit, and must not fail again there.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:
        reason = error.strerror or str(error)
        return _complain(f"{error.filename}: {reason}" if error.filename else reason, BAD_INPUT)
    except KeyboardInterrupt as error:
        return _complain(str(error) or "interrupted", INTERRUPTED)
    except SystemExit as error:  # argparse leaves this way after printing help
        return error.code if isinstance(error.code, int) else 0


@contextlib.contextmanager
def _replacing_characters() -> Iterator[None]:
    """Lets output replace what its encoding does not have: no name of a file is worth the results of an hour."""
    streams = [stream for stream in (sys.stdout, sys.stderr) if isinstance(stream, io.TextIOWrapper)]
    before = [stream.errors for stream in streams]
    for stream in streams:
        if stream.errors in ("strict", "surrogateescape"):
            stream.reconfigure(errors="replace")
    try:
        yield
    finally:
        for stream, errors in zip(streams, before, strict=True):
            with contextlib.suppress(ValueError):  # closed meanwhile
                stream.reconfigure(errors=errors)


def _run(arguments: list[str]) -> int:
    verb = arguments[0] if arguments else "--help"
    if verb in ("-h", "--help", "help"):
        say_text(_help())
        return 0
    if verb == "--version":
        say(f"murmurate {__version__}")
        return 0
    if verb not in VERBS:
        what = "flag" if verb.startswith("-") else "verb"
        known = ["--help", "--version"] if verb.startswith("-") else list(VERBS)
        raise UsageError(f"unknown {what} {verb}{suggestion(verb, known)} (see murmurate --help)")
    with warnings.catch_warnings():
        warnings.simplefilter("once", BeyondTrainingWarning)
        warnings.simplefilter("once", StartSetWarning)
        warnings.showwarning = _warn
        return importlib.import_module(f"murmurate.cli.{verb}").run(arguments[1:])


def _warn(message: Warning | str, *_: Any, **__: Any) -> None:
    """Shows a warning as one line."""
    say(one_line(f"murmurate: warning: {message}"), file=sys.stderr)


def _help() -> str:
    width = max(map(len, VERBS))
    return "\n".join(
        [
            "usage: murmurate VERB ...",
            "",
            "Discovers collisionless patterns in swarms of fat, opaque robots.",
            "",
            *(f"  {verb:{width}}  {text}" for verb, text in VERBS.items()),
            "",
            STATUS,
            "",
            "murmurate VERB --help tells more about a verb; murmurate --version prints the version.",
        ]
    )


def _complain(message: str, status: int) -> int:
    say(one_line(f"murmurate: {message}", MAX_LINE + 100), file=sys.stderr)
    return status

from __future__ import annotations

import errno
import io
import subprocess
import sys
from types import SimpleNamespace

import pytest

from murmurate import __version__
from murmurate.cli import main as command
from murmurate.cli.progress import Progress
from murmurate.errors import InputError, RunError, UsageError


@pytest.fixture
def verb(monkeypatch):
    """Puts a function in the place of every verb."""

    def put(run):
        monkeypatch.setattr(command.importlib, "import_module", lambda name: SimpleNamespace(run=run))

    return put


def raising(error):
    def run(argv):
        raise error

    return run


def test_help_and_version(capsys):
    for arguments in ([], ["--help"], ["-h"], ["help"]):
        assert command.main(arguments) == 0
        text = capsys.readouterr().out
        assert all(name in text for name in command.VERBS)
    assert command.main(["--version"]) == 0
    assert capsys.readouterr().out == f"murmurate {__version__}\n"


def test_the_status_is_the_verbs(verb):
    seen = []
    verb(lambda argv: seen.append(argv) or 3)
    assert command.main(["discover", "C", "--seed", "1"]) == 3
    assert seen == [["C", "--seed", "1"]]


@pytest.mark.parametrize(
    ("error", "line", "status"),
    [
        (InputError("world.radius", -1.0, "> 0"), "world.radius = -1.0: must be > 0", 2),
        (RunError("runs/C holds\nanother run"), "runs/C holds another run", 2),
        (UsageError("unknown flag --x"), "unknown flag --x", 2),
        (OSError(errno.ENOSPC, "No space left on device"), "No space left on device", 2),
        (FileNotFoundError(errno.ENOENT, "No such file", "x.csv"), "x.csv: No such file", 2),
        (KeyboardInterrupt(), "interrupted", 130),
        (KeyboardInterrupt("interrupted; continue with --resume"), "interrupted; continue with --resume", 130),
    ],
)
def test_errors_are_one_line(verb, capsys, error, line, status):
    verb(raising(error))
    assert command.main(["discover"]) == status
    assert capsys.readouterr() == ("", f"murmurate: {line}\n")


def test_help_of_a_verb_is_no_error(verb):
    verb(raising(SystemExit(0)))
    assert command.main(["discover", "--help"]) == 0


def test_defects_rise(verb):
    verb(raising(ZeroDivisionError()))
    with pytest.raises(ZeroDivisionError):
        command.main(["discover"])


@pytest.mark.parametrize(
    ("word", "line"),
    [
        ("discovr", "unknown verb discovr; did you mean discover? (see murmurate --help)"),
        ("train", "unknown verb train (see murmurate --help)"),
        ("--verson", "unknown flag --verson; did you mean --version? (see murmurate --help)"),
    ],
)
def test_unknown_verbs(word, line, capsys):
    assert command.main([word]) == 2
    assert capsys.readouterr() == ("", f"murmurate: {line}\n")


PIPE = """
import sys
from types import SimpleNamespace
from murmurate.cli import main as command
def run(argv):
    for _ in range(100_000):
        print("a line")
    return 0
command.importlib.import_module = lambda name: SimpleNamespace(run=run)
sys.exit(command.main(["show", "x"]))
"""


def test_a_reader_that_leaves_is_no_error():
    process = subprocess.Popen([sys.executable, "-c", PIPE], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    process.stdout.readline()
    process.stdout.close()
    assert process.stderr is not None
    assert process.stderr.read() == b""
    assert process.wait() == 141
    process.stderr.close()


def test_the_command_starts_without_jax():
    code = "import sys; from murmurate.cli.main import main; main(['--help']); sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False, stdout=subprocess.DEVNULL).returncode == 0


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_progress_on_a_terminal(monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    stream = Terminal()
    with Progress(stream) as progress:
        progress.update("base policy", 0, 150, note="compiling")
        progress.update("base policy", 75, 150, reward=0.0125, visible=0.874, steps_per_second=68123.4, kl=0.01234)
        progress.update("auxiliary policy", 1, 100, valid=0.5)
    text = stream.getvalue()
    for part in ("base policy", "compiling", "75/150", "reward +0.0125", "87% visible", "68,123 steps/s", "kl 0.0123"):
        assert part in text
    assert "auxiliary policy" in text
    assert "50% valid" in text


def test_progress_is_plain_lines_elsewhere():
    stream = io.StringIO()
    with Progress(stream) as progress:
        progress.update("base policy", 0, 2, note="compiling")
        progress.update("base policy", 1, 2, reward=1.0, steps_per_second=1234.5)
        progress.update("evaluation", 200, 200)
    assert stream.getvalue().splitlines() == [
        "base policy: 0/2  compiling",
        "base policy: 1/2  reward +1.0000  1,234 steps/s",
        "evaluation: 200/200",
    ]


def test_progress_can_be_quiet():
    for stream in (io.StringIO(), Terminal()):
        with Progress(stream, quiet=True) as progress:
            progress.update("base policy", 1, 2, reward=1.0)
        assert stream.getvalue() == ""

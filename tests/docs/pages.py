"""The pages of the documentation, and how what they show is executed or checked."""

from __future__ import annotations

import itertools
import os
import re
import shlex
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token

from murmurate.cli import discover
from murmurate.cli.main import VERBS, main
from murmurate.cli.sweep import _parser
from murmurate.discovery import check_parts
from murmurate.runs import presets
from murmurate.runs.grid import Grid
from murmurate.runs.paper import EXPERIMENTS
from murmurate.runs.problems import PROBLEMS

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted(page.relative_to(DOCS).as_posix() for page in DOCS.rglob("*.md"))
WRITTEN_BY_PROGRAMS = {"results.md", "point.md", "hard.md", "discoveries.md", "reproduction/report.md"}
WRITTEN_BY_PROGRAMS |= {page for page in PAGES if page.startswith("comparison/")}
BY_HAND = [page for page in PAGES if page not in WRITTEN_BY_PROGRAMS]

_NUMBERS = "--{0}.updates 2 --{0}.steps 4 --{0}.worlds 8 --{0}.minibatches 2"
# A file may have the numbers of every learner, and A to F only those of their own.
_LEARNERS = {"central": ["base.ppo", "auxiliary.ppo"], "formation": ["base.gradients", "auxiliary.gradients"]}
_LEARNERS |= {name: ["base.ppo", "base.gradients", "auxiliary.gradients"] for name in ("equivariant", "local")}
_ALL_LEARNERS = sorted({learner for learners in _LEARNERS.values() for learner in learners})
TINY = [
    "--discovery.sigma",
    "8",
    "--discovery.episodes",
    "8",
    "--discovery.max_policies",
    "2",
]
# Whatever was learned, it comes to rest at once.
TINY += ["--rest.max_steps", "20", "--rest.dead_zone", "0.3", "--rest.switch_tolerance", "0.5"]


def tokens(page: str, kind: str) -> list[Token]:
    """Returns the blocks of a page that are fenced (`fence`) or indented (`code_block`)."""
    return [token for token in MarkdownIt().parse((DOCS / page).read_text("utf-8")) if token.type == kind]


class Reader:
    """A reader of one page, who tries everything that it shows, in order, in a folder."""

    def __init__(self, page: str, folder: Path) -> None:
        self.page, self.folder = page, folder
        self.scope: dict[str, Any] = {"__name__": "__main__"}
        self.tried = 0

    def read(self) -> None:
        """Tries every block; one of a language that nobody can try is an error."""
        for token in tokens(self.page, "fence"):
            language = token.info.strip()
            if language.startswith("{"):  # a directive, which the strict build checks
                continue
            readers: dict[str, Callable[[str], None]] = {"python": self.python, "toml": self.toml, "sh": self.shell}
            assert language in readers, f"{self.page}: nothing checks a block of {language or 'no language'}"
            readers[language](token.content)
            self.tried += 1
        for token in tokens(self.page, "code_block"):
            first = {line.split()[0] for line in token.content.splitlines() if line.strip()}
            assert not first & {"$", "murmurate", "make", "pip", "python", "pytest"}, f"{self.page}: use a block of sh"

    def python(self, code: str) -> None:
        """Executes code with the names of the blocks before it; saves it if its first line names a file."""
        name = re.match(r"# ([\w-]+\.py)\n", code)
        if name:
            (self.folder / name[1]).write_text(code, "utf-8")
        else:
            exec(compile(code, self.page, "exec", dont_inherit=True), self.scope)

    def toml(self, text: str) -> None:
        """Saves an experiment or a sweep under the name that its first line gives, and checks it."""
        name = re.match(r"# ([\w-]+\.toml)\n", text)
        assert name, f"{self.page}: the first line of a block of TOML is `# name.toml`"
        path = self.folder / name[1]
        path.write_text(text, "utf-8")
        if "experiments" in tomllib.loads(text):
            Grid.from_toml(path)
        else:
            check_parts(presets.resolve(str(path)))  # evaluates every class that the page brings

    def shell(self, text: str) -> None:
        """Tries every command: ours are executed, of others it is checked that what they name exists."""
        for line in text.replace("\\\n", " ").splitlines():
            arguments = shlex.split(line, comments=True)
            while arguments and re.fullmatch(r"[A-Z_]+=\S*", arguments[0]):
                arguments = arguments[1:]
            if not arguments:
                continue
            if arguments[0] == "srun":
                arguments = arguments[arguments.index("murmurate") :]
            program = arguments[0].removeprefix(".venv/bin/")
            if program == "murmurate":
                self.murmurate(arguments[1:])
            elif program.endswith(".sh"):
                assert os.access(ROOT / program, os.X_OK), f"{self.page}: {program}: no such script"
            else:
                assert program in _CHECKS, f"{self.page}: nothing checks `{line}`"
                _CHECKS[program](arguments[1:])

    def murmurate(self, arguments: list[str]) -> None:
        """Executes one of our commands, with a small budget where it would train or run a thousand starts."""
        assert arguments[0] in VERBS, f"{self.page}: no verb {arguments[0]}"
        if arguments[0] == "sweep":  # which the tests of sweeps carry out
            _parser().parse(arguments[1:])
            Grid.from_toml(self.folder / arguments[1])
            return
        if "--hosts" in arguments:  # which the tests of devices carry out
            discover._parser("C", arguments[1:]).parse(arguments[1:])
            return
        small: list[str] = []
        if arguments[0] == "discover":
            small = [*TINY, *self.small_policy(arguments)]
            words = [*arguments, *small]
            chosen = words[words.index("--policy") + 1] if "--policy" in words else "formation"
            learners = _LEARNERS[chosen] if arguments[1] in EXPERIMENTS else _ALL_LEARNERS
            small += " ".join(map(_NUMBERS.format, learners)).split()
        elif arguments[0] == "evaluate" and not any(word.endswith(".csv") for word in arguments):
            small = ["--episodes", "8"]
        elif arguments[0] == "show" and "--robots" in arguments:
            small = ["--robots", "3"]
        elif arguments[0] == "compare":
            small = ["--robots", "3", "--episodes", "4", "--schedulers", "fsync"]
            small += [] if "--methods" in arguments else ["--methods", "learned,circle"]
            if "--starts" in arguments:
                small += ["--starts", arguments[arguments.index("--starts") + 1].split(",")[0]]
        status = main([*arguments, *small])
        # Nothing need have been learned in two updates.
        assert status in ((0, 3, 5) if arguments[0] == "discover" else (0,)), (
            f"{self.page}: murmurate {' '.join(arguments)}"
        )

    def small_policy(self, arguments: list[str]) -> list[str]:
        """Returns the flags of a small policy: central compiles fastest; others, in swarms of three."""
        hidden = ["--policy.hidden", "8,8"]
        if arguments[1] in PROBLEMS:
            size = ["--sizes", "4", "--world.robots", "4"] if arguments[1] != "arrow" else []
            return [
                *hidden,
                *size,
                "--discovery.max_policies",
                "1",
                "--policy.formations",
                "4",
                "--base.goals.updates",
                "100",
            ]
        if "formation" in arguments or "--diverse" in arguments or self.page == "formations.md":
            # A swarm of three has one pattern, and pages form the second.
            return [*hidden, "--world.robots", "6", "--policy.formations", "16", "--base.goals.updates", "1200"]
        if "--policy" in arguments:
            return [*hidden, "--world.robots", "3"]
        files = [self.folder / word for word in arguments if word.endswith(".toml")]
        tables = [tomllib.loads(path.read_text("utf-8")).get("policy", {}) for path in files]
        return [] if any(":" in table.get("use", "") for table in tables) else ["--policy", "central", *hidden]


def _make(arguments: list[str]) -> None:
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    assert {word for word in arguments if "=" not in word} <= targets, f"make {arguments}: no such target"


def _python(arguments: list[str]) -> None:
    if arguments[:2] == ["-m", "pip"]:
        _pip(arguments[2:])
    elif arguments[:1] == ["-m"]:
        assert arguments[1] == "venv" or (ROOT / arguments[1].split(".")[0]).is_dir(), (
            f"python -m {arguments[1]}: no such module"
        )
    else:
        assert (ROOT / arguments[0]).is_file(), f"python {arguments[0]}: no such file"


def _pip(arguments: list[str]) -> None:
    """Checks that what is installed is this project, extras of it, or what an extra brings; and that files exist."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    extras = project["optional-dependencies"]
    assert arguments[0] == "install"
    for flag, word in itertools.pairwise(arguments):
        if flag in ("-c", "--constraint"):
            assert (ROOT / word).is_file(), f"pip install {flag} {word}: no such file"
        elif not word.startswith("-"):
            name, _, wanted = word.rstrip("]").partition("[")
            assert name in (".", project["name"]), f"pip install {word}: not this project"
            assert set(filter(None, wanted.split(","))) <= set(extras), f"pip install {word}: no such extra"


def _pytest(arguments: list[str]) -> None:
    for word in arguments:
        assert not word.startswith("tests") or (ROOT / word).exists(), f"pytest {word}: no such path"


_CHECKS = {"make": _make, "python": _python, "python3": _python, "pip": _pip, "pytest": _pytest}


def copy_run(source: Path, target: Path) -> None:
    """Copies a run folder, as if it had been discovered there."""
    shutil.copytree(source, target, dirs_exist_ok=True)

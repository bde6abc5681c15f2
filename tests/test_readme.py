"""The README's example and commands, as a reader would try them."""

import re
from pathlib import Path

import jax
import pytest

from murmurate.cli.main import VERBS, main

README = Path(__file__).parents[1] / "README.md"
TINY = ["--base.ppo.updates", "1", "--base.ppo.steps", "4", "--base.ppo.worlds", "8", "--discovery.sigma", "8"]
TINY += ["--auxiliary.ppo.updates", "1", "--auxiliary.ppo.steps", "4", "--auxiliary.ppo.worlds", "8"]
TINY += ["--discovery.episodes", "8", "--rest.max_steps", "20", "--policy.hidden", "8,8"]


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def test_the_example_runs_on_a_run_that_discover_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = blocks("python")
    with jax.numpy_rank_promotion("allow"):
        assert main(["discover", "C", "--out", "runs/C-equivariant-seed0", *TINY]) in (0, 3)
        capsys.readouterr()
        exec(compile(example, str(README), "exec"), {})
    lengths, switches, seen = capsys.readouterr().out.splitlines()
    assert len(lengths.strip("[]").split()) == 5
    assert len(switches.strip("[]").split()) == 5
    assert len(seen.strip("[]").split()) == 10


def test_every_command_names_a_verb_that_exists() -> None:
    verbs = {line.split()[1] for block in blocks("sh") for line in block.splitlines() if line.startswith("murmurate ")}
    assert verbs
    assert verbs <= set(VERBS)


def test_every_linked_file_exists() -> None:
    pages = [README, *sorted((README.parent / "docs").glob("*.md"))]
    for page in pages:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert target.startswith("https://") or (page.parent / target).exists(), f"{page.name}: {target}"

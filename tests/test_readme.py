"""The README's example and commands, as a reader would try them."""

import re
from pathlib import Path

import jax
import pytest

from murmurate.cli.main import VERBS

README = Path(__file__).parents[1] / "README.md"


def blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)


def test_the_example_runs_without_any_training(capsys: pytest.CaptureFixture[str]) -> None:
    (example,) = blocks("python")
    with jax.numpy_rank_promotion("allow"):
        exec(compile(example, str(README), "exec"), {})
    lengths, valid, *visible = capsys.readouterr().out.splitlines()
    assert len(lengths.strip("[]").split()) == 5
    assert len(valid.strip("[]").split()) == 5
    assert [len(row.strip("[] ").split()) for row in visible] == 5 * [8]


def test_every_command_names_a_verb_that_exists() -> None:
    verbs = {line.split()[1] for block in blocks("sh") for line in block.splitlines() if line.startswith("murmurate ")}
    assert verbs
    assert verbs <= set(VERBS)


def test_the_paper_is_named_and_linked_in_the_first_paragraph() -> None:
    paragraph = " ".join(README.read_text(encoding="utf-8").split("\n\n")[1].split())
    assert "[Collisionless Pattern Discovery in Robot Swarms Using Deep Reinforcement Learning]" in paragraph
    assert "(https://arxiv.org/abs/2209.09865)" in paragraph


def test_numbers_are_ranges_over_the_seeds_of_the_results() -> None:
    """A seed's digits do not come back on another machine: what is published is how far the seeds differ."""
    results = table((README.parent / "docs" / "results.md").read_text(encoding="utf-8"), "seed")
    rows = table(README.read_text(encoding="utf-8"), "robots")
    assert [row[""] for row in rows] == [*"ABCDEF"]
    columns = {"valid of 200": "valid", "steps": "total steps", "bound": "bound", "steps / bound": "total / bound"}
    columns |= {"gap": "gap", "training": "training"}
    for row in rows:
        seeds = [result for result in results if result[""] == row[""]]
        assert len(seeds) >= 2
        assert [result["seed"] for result in seeds] == [str(seed) for seed in range(len(seeds))]
        for name, column in columns.items():
            least, *_, most = sorted((re.sub(r"%| s$", "", result[column]) for result in seeds), key=float)
            expected = least if least == most else f"{least}-{most}"
            assert re.sub(r"%| s$", "", row[name]) == expected, f"{row['']}: {name}"
        assert {result["paper's total"] for result in seeds} == {row["paper's steps"]}


def table(text: str, column: str) -> list[dict[str, str]]:
    """Returns the rows of the first table of a page whose second column has a name."""
    lines = text[text.index(f"|  | {column} |") :].partition("\n\n")[0].splitlines()
    header, _, *rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines]
    return [dict(zip(header, row, strict=True)) for row in rows]


def test_every_linked_file_exists() -> None:
    pages = [README, README.parent / "CONTRIBUTING.md", *sorted((README.parent / "docs").glob("*.md"))]
    for page in pages:
        for target in re.findall(r"\]\(([^)#]+)\)", page.read_text(encoding="utf-8")):
            assert target.startswith("https://") or (page.parent / target).exists(), f"{page.name}: {target}"


def test_the_layout_in_contributing_names_every_module() -> None:
    root = README.parent / "src" / "murmurate"
    text = (README.parent / "docs" / "contributing.md").read_text(encoding="utf-8")
    layout = text[text.index("src/murmurate/") : text.index("tests/  ")]
    modules = [path.relative_to(root) for path in root.rglob("*.py")]
    names = {part for module in modules for part in (*module.parts[:-1], module.stem) if module.parts[0] != "cli"}
    assert names - set(re.findall(r"\w+", layout)) == set()

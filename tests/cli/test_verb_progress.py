"""In a pipe or a log every long verb prints a line for each part of its work, and none with --quiet."""

from __future__ import annotations

import pytest

from murmurate.cli import show
from murmurate.cli.main import main

OPTIMUM = ["--annealing.chains", "16", "--annealing.moves_per_robot", "50", "--polished", "2", "--hops", "2"]


@pytest.mark.parametrize(
    ("words", "lines"),
    [
        (
            ["evaluate", "RUN", "--episodes", "8", "--out", "OUT"],
            ["episodes executed: 0/8", "episodes executed: 8/8", "episodes checked: 8/8"],
        ),
        (["catalogue", "RUN", "RUN", "--out", "OUT"], ["runs read: 1/2", "runs read: 2/2"]),
        (
            ["show", "--robots", "4", "--start", "scattered", "--animation", "OUT.webp"],
            ["episodes executed: 0/32", "episodes executed: 32/32", "episodes checked: 32/32"],
        ),
        (
            ["compare", "--methods", "learned,random", "--robots", "3", "--episodes", "6", "--out", "OUT"],
            [f"{method}, visible, fsync, random, N = 3: episodes: 6/6" for method in ("learned", "random")],
        ),
        (
            ["optimum", "C", "--world.robots", "4", *OPTIMUM],
            [
                *(f"rings: {index}/4" for index in range(5)),
                *(f"annealing, chains: {index}/16" for index in (0, 16)),
                *(f"polishing: {index}/2" for index in (1, 2)),
                *(f"basin hopping: {index}/2" for index in range(3)),
            ],
        ),
    ],
)
def test_lines_in_a_log_and_none_with_quiet(words, lines, discovered, tmp_path, capsys):
    for index, quiet in enumerate(([], ["--quiet"])):
        places = {"RUN": str(discovered), "OUT": str(tmp_path / f"out{index}"), "OUT.webp": str(tmp_path / "x.webp")}
        assert main([places.get(word, word) for word in words] + quiet) == 0
        printed = [line.partition("  ")[0] for line in capsys.readouterr().err.splitlines()]
        assert printed == ([] if quiet else lines)


def test_a_large_swarm_is_said_to_take_its_time(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(show, "LARGE", 3)
    monkeypatch.setattr(show, "MAX_PAIRS", 64)
    assert main(["show", "--robots", "4", "--animation", str(tmp_path / "x.webp")]) == 0
    out, err = capsys.readouterr()
    first = err.splitlines()[0]
    assert first.startswith("episodes executed: 0/4  about ")
    assert first.endswith((" seconds", " minutes", " hours"))
    assert " steps of " in first
    assert "4 robots, 4 starts: " in out


@pytest.mark.parametrize(
    ("seconds", "words"), [(3.2, "3 seconds"), (119, "119 seconds"), (600, "10 minutes"), (7200, "2 hours")]
)
def test_times_in_words(seconds, words):
    assert show._words(seconds) == words

"""In a pipe or a log every long verb prints a line for each part of its work, and none with --quiet."""

from __future__ import annotations

import math
import re

import pytest

from murmurate.cli.main import main
from murmurate.discovery import cascade
from murmurate.runs import progress

OPTIMUM = ["--annealing.chains", "16", "--annealing.moves_per_robot", "50", "--polished", "2", "--hops", "2"]
COMPARE = ["compare", "--methods", "learned", "--robots", "3", "--episodes", "4", "--out", "OUT"]


@pytest.mark.parametrize(
    ("arguments", "lines"),
    [
        (
            ["evaluate", "RUN", "--episodes", "8", "--out", "OUT"],
            ["episodes executed: 0/8", "episodes executed: 8/8", "episodes checked: 8/8"],
        ),
        (["catalogue", "RUN", "RUN", "--out", "OUT"], ["runs read: 1/2", "runs read: 2/2"]),
        (
            ["show", "--robots", "3", "--start", "scattered", "--animation", "OUT.webp"],
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
def test_lines_in_a_log_and_none_with_quiet(arguments, lines, discovered, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(progress, "CHUNK_SECONDS", math.inf)  # on a slow machine, there are lines about chunks besides
    for index, quiet in enumerate(([], ["--quiet"])):
        places = {"RUN": str(discovered), "OUT": str(tmp_path / f"out{index}"), "OUT.webp": str(tmp_path / "x.webp")}
        assert main([places.get(word, word) for word in arguments] + quiet) == 0
        printed = [line.partition("  ")[0] for line in capsys.readouterr().err.splitlines()]
        assert printed == ([] if quiet else lines)


@pytest.mark.parametrize("arguments", [["evaluate", "RUN", "--episodes", "4", "--out", "OUT"], COMPARE])
def test_long_episodes_are_reported(arguments, discovered, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(progress, "CHUNK_SECONDS", 0.0)
    monkeypatch.setattr(cascade, "CHUNK_TRIPLES", 4 * 3**3 * 5)
    for index, quiet in enumerate(([], ["--quiet"])):
        places = {"RUN": str(discovered), "OUT": str(tmp_path / f"out{index}")}
        assert main([places.get(word, word) for word in arguments] + quiet) == 0
        lines = [line for line in capsys.readouterr().err.splitlines() if "  step " in line]
        assert bool(lines) == (not quiet)
        assert all(re.search(r"episodes( executed)?: [0-4]/4  step \d+ of [\d,]+ at most", line) for line in lines)


def test_the_time_that_is_left_is_told_from_the_second_chunk_on(monkeypatch):
    now = iter([60.0, 61.0, 70.0, 90.0, 100.0])
    monkeypatch.setattr(progress.time, "monotonic", lambda: next(now))
    reported = []
    on_chunk = progress.on_chunk(
        lambda *args, **values: reported.append((args, values)), "episodes", 9, 1000.0, before=4
    )
    on_chunk(10, 5000, 0)  # with the compilation
    on_chunk(20, 5000, 1)  # too soon for another line
    on_chunk(110, 5000, 1)
    on_chunk(1000, 5000, 4)
    on_chunk(1010, 5000, 6)
    assert reported == [
        (("episodes", 5, 9), {"steps": "step 110 of 5,000 at most, about 89 seconds left"}),
        (("episodes", 8, 9), {"steps": "step 1,000 of 5,000 at most"}),
        (("episodes", 9, 9), {"steps": "step 1,010 of 5,000 at most"}),
    ]


@pytest.mark.parametrize(
    ("seconds", "arguments"), [(3.2, "3 seconds"), (119, "119 seconds"), (600, "10 minutes"), (7200, "2 hours")]
)
def test_times_in_words(seconds, arguments):
    assert progress.duration(seconds) == arguments

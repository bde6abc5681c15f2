from __future__ import annotations

import json

import numpy as np
import pytest

from murmurate.analysis.optimum.best_known import BestKnown, best_known, load
from murmurate.cli.main import main

SHORT = ["--annealing.chains", "16", "--annealing.moves_per_robot", "150", "--polished", "3"]


def test_without_a_word_the_best_known_are_listed(capsys):
    assert main(["optimum"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 2 + len(load())
    assert lines[0].startswith("| N | for | R | safe |")
    assert sum("proved" in line for line in lines) == 8


def test_a_search_stands_beside_what_is_known(tmp_path, capsys):
    out = tmp_path / "best.json"
    arguments = ["optimum", "C", "--world.robots", "4", "--world.half_width", "30", "--world.half_height", "30", *SHORT]
    assert main([*arguments, "--hops", "3", "--out", str(out)]) == 0
    shown = capsys.readouterr().out
    for part in ("4 robots, C1", "basin hopping, 3 rounds", "packing bound", "smallest regular ring", "equals it"):
        assert part in shown
    entry = BestKnown.from_dict(json.loads(out.read_text()))
    assert entry.command == " ".join(["murmurate", *arguments, "--hops", "3", "--out", str(out)])
    assert entry.target.is_valid(entry.positions)
    assert main([*arguments, "--out", str(out)]) == 2
    assert f"{out} is there already" in capsys.readouterr().err


def test_how_much_is_missing_is_in_percent_of_the_best_known(capsys):
    from murmurate.analysis.optimum.search import Formation, OptimumConfig
    from murmurate.cli import optimum
    from murmurate.runs import presets

    experiment = presets.resolve("C")
    config = OptimumConfig(experiment.world, experiment.objective)
    known = best_known(config.target)
    optimum._print_comparison(config, Formation(np.zeros((10, 2)), 0.985 * known, valid=False))
    assert capsys.readouterr().out == f"best known: {known:.7f}; this one is 1.5% short of it\n"


def test_where_no_pattern_is_valid_it_says_so(capsys):
    arguments = ["optimum", "C", "--world.robots", "4", "--world.scan_radius", "6", *SHORT, "--hops", "1"]
    assert main(arguments) == 3
    assert "No valid pattern was found" in capsys.readouterr().out


def test_weights_are_heeded(capsys):
    arguments = ["optimum", "--world.robots", "4", "--weights.gathering", "2", "--only_valid", "false", *SHORT]
    assert main(arguments) == 0
    assert "best known: none for these sizes" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (
            '[signals.near]\nuse = "compact"\nweight = 3.0\n',
            "signals.near = 'compact': must be left out: the search knows the signals of C1 and C2 alone",
        ),
        (
            "[valid]\nclose = 0.9\n",
            "valid.close = 0.9: must be left out: the search knows the paper's valid patterns alone",
        ),
        ('objective = "custom"\n[signals.near]\nuse = "compact"\n', "objective = 'custom': must be C1 or C2"),
    ],
)
def test_what_the_search_cannot_take_into_account_is_refused(text, line, tmp_path, capsys):
    (tmp_path / "own.toml").write_text(text)
    assert main(["optimum", str(tmp_path / "own.toml"), *SHORT]) == 2
    assert capsys.readouterr().err == f"murmurate: {line}\n"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["Z"], "experiment = 'Z': must be one of A, B, C, D, E, F"),
        (["C", "--world.robots", "1"], "world.robots = 1: must be an integer >= 2"),
        (["C", "--hops", "-2"], "hops = -2"),
        (["C", "--annealing.chains", "0"], "annealing.chains = 0"),
        (["C", "--objective", "C9"], "objective = 'C9': must be one of C1, C2"),
        (["C", "--anealing.chains", "3"], "did you mean --annealing.chains?"),
        (["C", "D"], "unrecognized arguments: D"),
        (["C", "--out", "nowhere/best.json"], "nowhere is no folder: choose another --out"),
    ],
)
def test_bad_words_are_one_line(arguments, message, capsys):
    assert main(["optimum", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1

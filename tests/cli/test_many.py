from __future__ import annotations

import json

import numpy as np
import pytest
from safetensors.numpy import load_file

from murmurate.cli.main import main
from murmurate.runs.experiment import load
from murmurate.runs.folder import RunFolder


def discover(tiny_toml, out, *arguments):
    return main(["discover", str(tiny_toml), "--out", str(out), *arguments])


def test_seeds_are_runs_of_their_own_and_fill_one_catalogue(tiny_toml, discovered, tmp_path, capsys):
    assert discover(tiny_toml, tmp_path, "--seeds", "2") == 0
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"tiny-central-seed0", "tiny-central-seed1", "tiny-central-catalogue"}
    assert [load(tmp_path / f"tiny-central-seed{seed}").seed for seed in (0, 1)] == [0, 1]
    # A run of many is the run that it would be alone.
    for file in ("policies/0-base.safetensors", "policies/1-auxiliary.safetensors", "evaluation.json"):
        assert (tmp_path / "tiny-central-seed0" / file).read_bytes() == (discovered / file).read_bytes()
    data = json.loads((tmp_path / "tiny-central-catalogue" / "catalogue.json").read_text())
    assert {finding["seed"] for finding in data["findings"]} == {0, 1}
    out, err = capsys.readouterr()
    lines = [line.partition("  ")[0] for line in err.splitlines()]
    for seed in (0, 1):
        for work in ("base policy", "auxiliary policy"):
            assert lines.count(f"tiny-central-seed{seed}: {work}: 2/4") == 1
            assert lines.count(f"tiny-central-seed{seed}: {work}: 4/4") == 1
        assert lines.count(f"tiny-central-seed{seed}: evaluation: 200/200") == 1
    assert out.count("| tiny | central |") == 2
    assert "plates: " in out


def test_side_by_side_they_end_as_in_turn(tiny_toml, discovered, tmp_path, capsys):
    arguments = ["--seeds", "2", "--together", "4", "--vary", "auxiliary.ppo.discount=0.8,0.9"]
    assert discover(tiny_toml, tmp_path, *arguments) == 0
    alone, beside = discovered, tmp_path / "tiny-central-seed0-discount0.9"
    assert load(beside) == load(alone)
    for name in ("0-base", "1-auxiliary"):
        a, b = (load_file(folder / "policies" / f"{name}.safetensors") for folder in (alone, beside))
        assert a.keys() == b.keys()
        for key in a:
            np.testing.assert_allclose(a[key], b[key], rtol=1e-3, atol=1e-4)
    assert len([path for path in tmp_path.iterdir() if (path / "manifest.json").exists()]) == 4


def test_they_are_resumed_and_never_overwritten(tiny_toml, tmp_path, capsys):
    assert discover(tiny_toml, tmp_path / "tiny-central-seed0") == 0
    before = (tmp_path / "tiny-central-seed0" / "manifest.json").read_bytes()
    capsys.readouterr()
    assert discover(tiny_toml, tmp_path, "--seeds", "2") == 2
    assert "tiny-central-seed0 holds another run" in capsys.readouterr().err
    assert not (tmp_path / "tiny-central-seed1").exists()
    assert discover(tiny_toml, tmp_path, "--seeds", "2", "--resume") == 0
    assert (tmp_path / "tiny-central-seed0" / "manifest.json").read_bytes() == before
    assert discover(tiny_toml, tmp_path, "--seeds", "1", "--resume", "--base.horizon", "9") == 2
    assert "base.horizon is 8 there, 9 here" in capsys.readouterr().err


def test_fields_vary_with_every_seed(tiny_toml, tmp_path, capsys):
    arguments = ["--vary", "auxiliary.ppo.discount=0.8,0.9", "--vary", "base.horizon=7", "--seed", "3"]
    assert discover(tiny_toml, tmp_path, *arguments) == 0
    result = {path.name: load(path) for path in tmp_path.iterdir() if "catalogue" not in path.name}
    lines = [line for line in capsys.readouterr().out.splitlines() if line.startswith(f"| {tmp_path}")]
    for discount in ("0.8", "0.9"):
        folder = tmp_path / f"tiny-central-seed3-discount{discount}-horizon7"
        start = f"| {folder} | tiny | central | 3 | auxiliary.ppo.discount={discount} |"
        assert sum(line.startswith(start) for line in lines) == 1
    assert set(result) == {f"tiny-central-seed3-discount{discount}-horizon7" for discount in ("0.8", "0.9")}
    assert {(config.auxiliary.ppo.discount, config.base.horizon, config.seed) for config in result.values()} == {
        (0.8, 7, 3),
        (0.9, 7, 3),
    }


def test_each_begins_with_the_policies_of_one_run(tiny_toml, discovered, tmp_path, capsys):
    arguments = ["--from", str(discovered), "--vary", "base.horizon=7,8"]
    assert discover(tiny_toml, tmp_path, *arguments) in (0, 3)
    folders = [RunFolder(tmp_path / f"tiny-central-seed0-horizon{horizon}") for horizon in (7, 8)]
    checksums = RunFolder(discovered).manifest()["checksums"]
    for folder in folders:
        initial = folder.manifest()["initial"]
        assert (initial["experiment"], initial["seed"]) == ("tiny", 0)
        assert initial["checksums"].items() <= checksums.items()
    capsys.readouterr()
    # What does not fit is refused before anything is trained.
    assert discover(tiny_toml, tmp_path / "shapes", *arguments, "--policy.hidden", "4,4") == 2
    assert "the base policy to begin with has " in capsys.readouterr().err
    assert not (tmp_path / "shapes").exists()
    other = [*arguments[2:], "--from", str(folders[0].path), "--resume"]
    assert discover(tiny_toml, tmp_path, *other) == 2
    assert "did not begin with the policies of" in capsys.readouterr().err


def test_no_valid_pattern_in_any_of_them_is_status_3(tiny_toml, tmp_path, capsys):
    assert discover(tiny_toml, tmp_path, "--seeds", "1", "--world.scan_radius", "2.5") == 3
    assert "No valid pattern was discovered" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--seeds", "0"], "--seeds = 0: must be an integer >= 1"),
        (["--seeds", "x"], "--seeds"),
        (["--seed", "4294967295", "--seeds", "2"], "--seeds = 2: must be at most 1"),
        (["--vary", "base.horizn=3"], "did you mean base.horizon?"),
        (["--vary", "base.horizon"], "must be FIELD=VALUE,... with one or more values"),
        (["--vary", "base.horizon=3,3"], "none of them twice"),
        (["--vary", "base.horizon=3,x"], "base.horizon = 'x'"),
        (["--vary", "base.horizon=0"], "base.horizon = 0: must be an integer >= 1"),
        (["--seeds", "2", "--together", "0"], "--together = 0: must be an integer >= 1"),
        (["--together", "2"], "--together is for many runs: it needs --seeds or --vary"),
        (["--vary", "seed=1,2"], "--vary = 'seed=1,2'"),
    ],
)
def test_bad_words_are_one_line_and_leave_nothing(arguments, message, tiny_toml, tmp_path, capsys):
    assert discover(tiny_toml, tmp_path / "many", *arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "many").exists()


def test_a_linked_catalogue_is_refused_before_training(tiny_toml, tmp_path, capsys):
    elsewhere, out = tmp_path / "elsewhere", tmp_path / "out"
    elsewhere.mkdir()
    out.mkdir()
    (out / "tiny-central-catalogue").symlink_to(elsewhere)
    assert discover(tiny_toml, out, "--seeds", "2") == 2
    assert "tiny-central-catalogue is a link" in capsys.readouterr().err
    assert list(elsewhere.iterdir()) == []
    assert [path.name for path in out.iterdir()] == ["tiny-central-catalogue"]

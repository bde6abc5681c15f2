from __future__ import annotations

import json
import shutil

import numpy as np
import pytest

from murmurate.cli.main import main
from murmurate.runs import presets, storage, train
from murmurate.runs.experiment import load

FIGURE, ANIMATION = "figures/discovery.png", "figures/discovery.gif"


@pytest.fixture
def run(discovered, tmp_path):
    """A copy of the run that a test may change."""
    return shutil.copytree(discovered, tmp_path / "run")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_discover_leaves_a_run_and_its_picture(discovered):
    assert (discovered / FIGURE).read_bytes().startswith(b"\x89PNG")
    assert storage.read_manifest(discovered)["experiment"] == "tiny"


def test_discover_says_what_it_found(discovered, tiny_toml, capsys):
    before = contents(discovered)
    assert main(["discover", str(tiny_toml), "--out", str(discovered), "--resume"]) == 0
    assert contents(discovered) == before
    out, err = capsys.readouterr()
    for part in ("200 fresh starts", "base steps", "total / bound", "valid pattern", f"picture: {discovered / FIGURE}"):
        assert part in out
    assert f"murmurate show {discovered}" in out
    assert err == ""


def test_the_default_folder_names_experiment_learner_and_seed(tiny_toml, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "more.toml").write_text("seed = 5\n[base]\nhorizon = 9\n")
    words = ["discover", str(tiny_toml), "--config", "more.toml", "--seed", "6", "--base.ppo.clip", "0.1"]
    assert main(words) in (0, 3)
    config = load("runs/tiny-central-seed6")
    assert (config.seed, config.base.horizon, config.base.ppo.clip) == (6, 9, 0.1)


def test_no_valid_pattern_is_status_3_and_the_run_is_kept(tiny_toml, tmp_path, capsys):
    out = tmp_path / "run"
    assert main(["discover", str(tiny_toml), "--out", str(out), "--world.scan_radius", "2.5"]) == 3
    assert f"No valid pattern was discovered. The run is kept in {out}" in capsys.readouterr().out
    assert storage.read_manifest(out)["outcome"] == "no valid pattern was discovered"
    assert (out / FIGURE).exists()
    assert main(["discover", str(tiny_toml), "--out", str(out), "--world.scan_radius", "2.5", "--resume"]) == 3


def test_policies_that_went_astray_are_no_valid_pattern(tiny_toml, tmp_path, capsys):
    out = tmp_path / "run"
    words = ["--base.ppo.policy_rate", "1e30", "--base.ppo.policy_rate_end", "1e30"]
    assert main(["discover", str(tiny_toml), "--out", str(out), *words]) == 3
    assert "No valid pattern was discovered" in capsys.readouterr().out
    assert json.loads((out / "evaluation.json").read_text())["valid"] == 0
    assert main(["table", str(out)]) == 0


def test_interrupting_says_how_to_go_on(tiny_toml, tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "advance_together", interrupted)
    assert main(["discover", str(tiny_toml), "--out", str(tmp_path / "run")]) == 130
    err = capsys.readouterr().err
    assert err == f"murmurate: interrupted; add --resume to the same command to go on with {tmp_path / 'run'}\n"


def test_evaluate_replaces_the_evaluation(run, capsys):
    before = contents(run)
    assert main(["evaluate", str(run), "--seed", "1"]) == 0
    summary = storage.read_json(run / "evaluation.json")
    assert (summary["episodes"], summary["seed"], summary["starts"]) == (200, 1, "fresh")
    changed = {path.name for path, data in contents(run).items() if before.get(path) != data}
    assert changed == {"evaluation.json", "trajectories.npz", "discovery.png"}
    assert main(["evaluate", str(run)]) == 0
    assert contents(run) == before
    assert f"picture: {run / FIGURE}" in capsys.readouterr().out


def test_evaluate_can_leave_the_run_alone(discovered, tmp_path):
    before, out = contents(discovered), tmp_path / "other"
    assert main(["evaluate", str(discovered), "--seed", "1", "--out", str(out)]) == 0
    assert contents(discovered) == before
    assert main(["evaluate", str(out), "--out", str(out)]) == 0
    assert (out / "evaluation.json").read_bytes() == (discovered / "evaluation.json").read_bytes()
    assert (out / FIGURE).exists()


def test_evaluate_takes_every_start_of_a_file_in_order(run, tmp_path, capsys):
    generator = np.random.default_rng(0)
    starts = np.stack([np.array([[-8, 0], [0, 0], [8, 0]]) + generator.uniform(-2, 2, (3, 2)) for _ in range(8)])
    rows = [f"{name},{x},{y}" for name, start in zip("hgfedcba", starts, strict=True) for x, y in start]
    (tmp_path / "mine.csv").write_text("\n".join(["start,x,y", *rows]))
    assert main(["evaluate", str(run), "--starts", str(tmp_path / "mine.csv")]) == 0
    summary = storage.read_json(run / "evaluation.json")
    assert (summary["episodes"], summary["starts"]) == (8, "mine.csv")
    recorded = storage.read_npz(run / "trajectories.npz")["positions"][:, 0]
    assert np.array_equal(recorded, starts.astype(np.float32))
    assert "8 mine.csv starts" in capsys.readouterr().out


def test_show_draws_and_animates(run, tmp_path, capsys):
    before = contents(run)
    assert main(["show", str(run), "--episode", "0"]) == 0
    changed = {path.name for path, data in contents(run).items() if before.get(path) != data}
    assert changed <= {"discovery.png", "discovery.gif"}
    assert (run / ANIMATION).read_bytes().startswith(b"GIF8")
    assert f"animation: {run / ANIMATION}" in capsys.readouterr().out
    assert main(["show", str(run), str(run), "--out", str(tmp_path / "both")]) == 0
    assert [path.name for path in (tmp_path / "both").iterdir()] == ["patterns.png"]


def test_table_is_markdown(discovered, capsys):
    assert main(["table", str(discovered), str(discovered)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 4
    assert lines[0].startswith("| experiment | policy | seed | valid |")
    assert lines[2].startswith("| tiny | central | 0 | ")


def test_experiments_are_listed(capsys):
    assert main(["experiments"]) == 0
    out = capsys.readouterr().out
    for part in ("A", "F", "distributed", "at the origin", "1168.83"):
        assert part in out


def test_an_experiment_is_written_out_as_toml(tmp_path, capsys):
    assert main(["experiments", "F", "--learner", "central"]) == 0
    path = tmp_path / "mine.toml"
    path.write_text(capsys.readouterr().out)
    assert presets.resolve(str(path)) == presets.preset("F", "central")


def test_help_shows_the_defaults_of_the_experiment(capsys):
    assert main(["discover", "A", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Bound on each velocity component, world units per step. (default: 0.4)" in text
    assert "Defaults are those of experiment A with the equivariant learner." in text
    for verb in ("evaluate", "show", "experiments", "table"):
        assert main([verb, "--help"]) == 0
        assert f"usage: murmurate {verb}" in capsys.readouterr().out

from __future__ import annotations

import shutil

import numpy as np
import pytest

from murmurate.cli.main import main
from murmurate.runs import files, presets, train
from murmurate.runs.experiment import load
from murmurate.runs.folder import RunFolder, describe_starts, is_fresh

FIGURE, ANIMATION = "figures/discovery.png", "figures/discovery.gif"


@pytest.fixture
def run(discovered, tmp_path):
    """A copy of the run that a test may change."""
    return shutil.copytree(discovered, tmp_path / "run")


def contents(folder):
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_discover_leaves_a_run_and_its_picture(discovered):
    assert (discovered / FIGURE).read_bytes().startswith(b"\x89PNG")
    assert RunFolder(discovered).manifest()["experiment"] == "tiny"


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
    assert RunFolder(out).manifest()["valid_pattern"] is False
    assert (out / FIGURE).exists()
    assert main(["discover", str(tiny_toml), "--out", str(out), "--world.scan_radius", "2.5", "--resume"]) == 3


def test_a_training_that_diverges_is_one_line(tiny_toml, tmp_path, capsys):
    out = tmp_path / "run"
    words = ["--base.ppo.policy_rate", "1e30", "--base.ppo.policy_rate_end", "1e30", "--quiet"]
    assert main(["discover", str(tiny_toml), "--out", str(out), *words]) == 2
    printed, err = capsys.readouterr()
    assert printed == ""
    assert err.startswith(f"murmurate: {out}: the training of the base policy diverged at update ")
    assert err.count("\n") == 1
    assert RunFolder(out).inspect(resume=True) == "unfinished"


def test_progress_is_a_line_for_each_chunk_in_a_log_and_none_with_quiet(tiny_toml, tmp_path, capsys):
    assert main(["discover", str(tiny_toml), "--out", str(tmp_path / "run")]) == 0
    lines = capsys.readouterr().err.splitlines()
    assert [line.partition("  ")[0] for line in lines] == [
        "base policy: 0/4",
        "base policy: 2/4",
        "base policy: 4/4",
        "auxiliary policy: 2/4",
        "auxiliary policy: 4/4",
        "evaluation: 0/200",
        "evaluation: 200/200",
    ]
    assert main(["discover", str(tiny_toml), "--out", str(tmp_path / "other"), "--quiet"]) == 0
    assert capsys.readouterr().err == ""


def test_discover_begins_with_the_policies_of_a_run(discovered, tiny_toml, tmp_path, capsys):
    out = tmp_path / "run"
    words = ["discover", str(tiny_toml), "--from", str(discovered), "--seed", "1", "--out", str(out)]
    assert main(words) in (0, 3)
    assert RunFolder(out).manifest()["initial"]["experiment"] == "tiny"
    assert main([*words, "--resume"]) in (0, 3)
    capsys.readouterr()
    other = ["discover", str(tiny_toml), "--from", str(tmp_path / "none"), "--out", str(tmp_path / "x")]
    assert main(other) == 2
    assert "none holds no run" in capsys.readouterr().err
    assert main([*other[:3], str(discovered), *other[4:], "--policy.hidden", "4,4"]) == 2
    assert "the base policy to begin with has " in capsys.readouterr().err
    assert not (tmp_path / "x").exists()


def test_interrupting_says_how_to_go_on(tiny_toml, tmp_path, capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(train, "advance_together", interrupted)
    assert main(["discover", str(tiny_toml), "--out", str(tmp_path / "run"), "--quiet"]) == 130
    err = capsys.readouterr().err
    assert err == f"murmurate: interrupted; add --resume to the same command to go on with {tmp_path / 'run'}\n"


def test_evaluate_replaces_the_evaluation(run, capsys):
    before = contents(run)
    assert main(["evaluate", str(run), "--seed", "1"]) == 0
    summary = RunFolder(run).evaluation()
    assert (summary["episodes"], summary["seed"], is_fresh(summary)) == (200, 1, True)
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
    summary = RunFolder(run).evaluation()
    assert (summary["episodes"], describe_starts(summary)) == (8, "starts of mine.csv")
    recorded = files.read_npz(run / "trajectories.npz")["positions"][:, 0]
    assert np.array_equal(recorded, starts.astype(np.float32))
    assert "8 starts of mine.csv" in capsys.readouterr().out


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
    assert main(["discover", "A", "--help-all"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert "Bound on each velocity component, world units per step. (default: 0.4)" in text
    assert "Defaults are those of experiment A." in text
    for verb in ("evaluate", "show", "experiments", "table"):
        assert main([verb, "--help"]) == 0
        assert f"usage: murmurate {verb}" in capsys.readouterr().out


@pytest.mark.parametrize(("verb", "flags"), [("discover", 12), ("optimum", 7)])
def test_help_is_one_page_and_help_all_has_every_field(verb, flags, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    assert main([verb, "A", "--help"]) == 0
    page = capsys.readouterr().out
    assert page.count("\n") <= 60
    assert sum(line.startswith("  --") for line in page.splitlines()) == flags
    assert main([verb, "A", "--help-all"]) == 0
    everything = capsys.readouterr().out
    for flag in ("--world.radius", "--world.max_speed"):
        assert flag in everything
        assert flag not in page


def test_the_help_of_experiments_names_what_its_errors_name(capsys):
    assert main(["experiments", "--help"]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert main(["experiments", "G"]) == 2
    allowed = capsys.readouterr().err.partition("must be one of ")[2].strip()
    assert allowed == "A, B, C, D, E, F, or a TOML file"
    assert allowed in text
    assert main(["experiments", "A", "--learner", "best"]) == 2
    allowed = capsys.readouterr().err.partition("must be one of ")[2].strip()
    assert allowed == ", ".join(presets.TRAINING_PRESETS)
    assert allowed in text

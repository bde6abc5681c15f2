from __future__ import annotations

import shutil

import numpy as np
import pytest

from murmurate import plots
from murmurate.cli.main import main
from murmurate.plots.run import describe_swarm
from murmurate.plots.style import new_page
from murmurate.runs import files, presets, train
from murmurate.runs.experiment import load
from murmurate.runs.folder import RunFolder, describe_starts, is_fresh
from murmurate.runs.problems import PROBLEMS

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
    command = ["discover", str(tiny_toml), "--config", "more.toml", "--seed", "6", "--base.ppo.clip", "0.1"]
    assert main(command) in (0, 3)
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
    options = ["--base.ppo.policy_rate", "1e30", "--base.ppo.policy_rate_end", "1e30", "--quiet"]
    assert main(["discover", str(tiny_toml), "--out", str(out), *options]) == 2
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
    command = ["discover", str(tiny_toml), "--from", str(discovered), "--seed", "1", "--out", str(out)]
    assert main(command) in (0, 3)
    assert RunFolder(out).manifest()["initial"]["experiment"] == "tiny"
    assert main([*command, "--resume"]) in (0, 3)
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
    assert changed == {"evaluation.json", "trajectories.npz", "discovery.png", "manifest.json"}
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


def changed_copy(folder, path, old, new):
    """A copy of a run with one field changed in its configuration."""
    shutil.copytree(folder, path)
    text = (path / "experiment.toml").read_text()
    assert text.count(old) >= 1
    run = RunFolder(path)
    files.write_text(path / "experiment.toml", text.replace(old, new))
    run.write_manifest(run.manifest(), policies=2)
    return path


def test_table_tells_runs_apart_and_has_no_empty_column(discovered, tmp_path, capsys):
    other = changed_copy(discovered, tmp_path / "other", "horizon = 8", "horizon = 9")
    assert main(["table", str(discovered), str(other)]) == 0
    lines = capsys.readouterr().out.splitlines()
    header, _, *rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]
    assert header[:6] == ["run", "experiment", "policy", "seed", "fields", "valid"]
    assert [row[0] for row in rows] == [str(discovered), str(other)]
    assert [row[4] for row in rows] == [
        "base.horizon=8, auxiliary.horizon=8",
        "base.horizon=9, auxiliary.horizon=9",
    ]
    assert "paper's total" not in header
    assert {"contact-free", "inside"} <= set(header)
    assert main(["table", str(discovered), str(discovered)]) == 0
    assert capsys.readouterr().out.startswith("| run | experiment | policy | seed | valid |")


def test_table_leaves_out_what_is_not_finished_and_lists_it(discovered, tmp_path, capsys):
    unfinished, empty = tmp_path / "unfinished", tmp_path / "empty"
    unfinished.mkdir()
    empty.mkdir()
    shutil.copy(discovered / "experiment.toml", unfinished)
    assert main(["table", str(unfinished), str(discovered), str(empty)]) == 0
    out, err = capsys.readouterr()
    assert out.count("| tiny | central |") == 1
    assert err.splitlines() == [
        f"murmurate: left out: {unfinished} holds an unfinished run: finish it with murmurate discover --resume",
        f"murmurate: left out: {empty} holds no run: it has no manifest.json",
    ]
    damaged = shutil.copytree(discovered, tmp_path / "damaged")
    (damaged / "policies" / "0-base.safetensors").write_bytes(b"x")
    assert main(["table", str(damaged), str(discovered)]) == 2
    assert capsys.readouterr().out.count("| tiny | central |") == 1
    assert main(["table", str(unfinished)]) == 2
    assert capsys.readouterr().out == ""


def test_show_names_runs_by_their_folders_and_what_differs(discovered, tmp_path, capsys, monkeypatch):
    other, reported = changed_copy(discovered, tmp_path / "other", "horizon = 8", "horizon = 9"), []
    monkeypatch.setattr(plots, "patterns_figure", lambda *arguments: reported.append(arguments) or new_page(1))
    assert main(["show", str(discovered), str(other), "--out", str(tmp_path / "both")]) == 0
    (_, names, notes), out = reported[0], capsys.readouterr().out
    assert names == ["central", "other"]
    assert notes == ["base.horizon=8, auxiliary.horizon=8", "base.horizon=9, auxiliary.horizon=9"]
    assert "other: base.horizon=9, auxiliary.horizon=9\n" in out


def test_an_evaluation_says_what_failed_and_why(tiny_run, tmp_path, capsys):
    """Robots on a line see only their neighbours; exactly on a line, robots that are all alike stay there."""
    starts = tmp_path / "line.csv"
    starts.write_text("start,x,y\n" + "".join(f"7,{x},0\n" for x in (-6, 0, 6)) + "3,-6,0.1\n3,0,0\n3,5,0.2\n")
    out = tmp_path / "out"
    assert main(["evaluate", str(tiny_run("equivariant")), "--starts", str(starts), "--out", str(out)]) == 0
    output, summary = capsys.readouterr().out, RunFolder(out).evaluation()
    hidden = round(2 * (1 - summary["mutually_visible"]))
    assert hidden >= 1
    assert f"{len(summary['failures'])} of 2 starts failed: " in output
    assert f"{hidden} not mutually visible" in output
    assert 0 in summary["failures"]
    assert "began symmetric and stayed so" in output
    assert "contact-free" in output
    assert "inside" in output
    # The picture of given starts does not call them what the experiment's own are.
    recording = plots.Recording.open(out)
    assert describe_swarm(recording) == "3 robots, starts of line.csv"
    assert describe_swarm(plots.Recording.open(tiny_run("equivariant"))) == "3 robots, scattered start"


def test_fewer_valid_patterns_than_required_have_a_status_of_their_own(copy_of_tiny_run, tiny_toml, capsys):
    run = RunFolder(copy_of_tiny_run())
    command = ["discover", str(tiny_toml), "--out", str(run.path), "--resume"]
    summary, arrays = run.evaluation(), files.read_npz(run.path / "trajectories.npz")
    formed = arrays["positions"].copy()
    for count, status, line in (
        (3, 5, "Valid patterns from 1.5% of the starts; discovery.required_valid asks for 50.0%."),
        (84, 5, "Valid patterns from 42.0% of the starts; discovery.required_valid asks for 50.0%."),
        (98, 0, "animation: "),  # as good as one half, by chance
        (199, 0, "animation: "),
    ):
        arrays["positions"] = formed.copy()
        arrays["positions"][count:, 1:, 0] = 30.0  # outside the world
        run.write_evaluation(summary, arrays)
        assert main(command) == status
        assert line in capsys.readouterr().out
    for command in (["--help"], ["discover", "--help"]):
        assert main(command) == 0
        assert "5 fewer of them than discovery.required_valid asks for" in " ".join(capsys.readouterr().out.split())


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


@pytest.mark.parametrize(("verb", "flags"), [("discover", 13), ("optimum", 8)])
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
    assert allowed == f"A, B, C, D, E, F, {', '.join(PROBLEMS)}, or a TOML file"
    assert allowed in text
    assert main(["experiments", "A", "--learner", "best"]) == 2
    allowed = capsys.readouterr().err.partition("must be one of ")[2].strip()
    assert allowed == ", ".join(presets.TRAINING_PRESETS)
    assert allowed in text

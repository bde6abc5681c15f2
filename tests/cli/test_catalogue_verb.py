from __future__ import annotations

import csv
import json
import shutil

import numpy as np
import pytest

from murmurate.analysis import Catalogue, Finding
from murmurate.cli.main import main
from murmurate.runs import catalogues, files
from murmurate.runs.folder import RunFolder
from tiny import write_toml


@pytest.fixture(scope="module")
def second(tmp_path_factory):
    """Another run of the tiny experiment."""
    folder = tmp_path_factory.mktemp("second")
    assert main(["discover", str(write_toml(folder / "tiny.toml")), "--seed", "1", "--out", str(folder / "run")]) == 0
    return folder / "run"


def refused(capsys, arguments, *parts):
    assert main(["catalogue", *map(str, arguments), "--quiet"]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    for part in parts:
        assert part in err


FILES = ("catalogue.json", "catalogue.csv", "map.csv", "map.png", "plate.png")


def test_it_leaves_json_csv_and_plates(discovered, second, tmp_path, capsys):
    out = tmp_path / "catalogue"
    assert main(["catalogue", str(discovered), str(second), "--out", str(out)]) == 0
    assert {path.name for path in out.iterdir()} == set(FILES)
    data = json.loads((out / "catalogue.json").read_text())
    rows = list(csv.DictReader((out / "catalogue.csv").read_text().splitlines()))
    assert sum(int(row["count"]) for row in rows) == len(data["findings"])
    assert "tiny central 0" in rows[0]["seeds"] or "tiny central 1" in rows[0]["seeds"]
    cells = list(csv.DictReader((out / "map.csv").read_text().splitlines()))
    assert sum(int(cell["patterns"]) for cell in cells) == len(rows)
    for plate in ("map.png", "plate.png"):
        assert (out / plate).read_bytes().startswith(b"\x89PNG")
    shown = capsys.readouterr().out
    counted = f"map: {out / 'map.csv'}, {len(cells)} cell"
    for part in ("symmetry", "margin", "P1", f"plates: {out / 'plate.png'}", counted):
        assert part in shown


def test_merging_catalogues_is_the_catalogue_of_all_runs_in_any_order(discovered, second, tmp_path):
    def make(name, *sources):
        assert main(["catalogue", *map(str, sources), "--out", str(tmp_path / name)]) == 0
        return tmp_path / name

    first_part, second_part = make("one", discovered), make("two", second)
    together = [
        make(name, *sources)
        for name, sources in {
            "runs": (discovered, second),
            "merged": (first_part, second_part),
            "reversed": (second_part, first_part, discovered),
        }.items()
    ]
    for name in FILES:
        assert len({(folder / name).read_bytes() for folder in together}) == 1


def test_a_catalogue_is_replaced_and_nothing_else_is(discovered, tmp_path, capsys):
    out = tmp_path / "catalogue"
    assert main(["catalogue", str(discovered), "--out", str(out)]) == 0
    assert main(["catalogue", str(discovered), "--out", str(out), "--no-reflection"]) == 0
    assert json.loads((out / "catalogue.json").read_text())["reflection"] is False
    capsys.readouterr()
    refused(capsys, [discovered, "--out", discovered], f"{discovered} holds other files")


@pytest.mark.parametrize("number", ["0", "-1", "nan", "inf"])
def test_tolerances_are_positive(number, discovered, capsys):
    refused(capsys, [discovered, "--tolerance", number], "--tolerance = ", "must be a finite number > 0")


def test_without_scaling_a_tolerance_is_needed(discovered, tmp_path, capsys):
    refused(capsys, [discovered, "--no-scaling", "--out", tmp_path / "x"], "tolerance = None: must be given")
    assert main(["catalogue", str(discovered), "--no-scaling", "--tolerance", "1", "--out", str(tmp_path / "y")]) == 0


def folder_of(path, robots, radius, value=3.9, gap=None):
    """A catalogue with one finding, a ring."""
    angles = 2 * np.pi * np.arange(robots) / robots
    ring = 9 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reported = {
        "objective": "C2",
        "value": value,
        "gap": gap,
        "experiment": "ring",
        "policy": "central",
        "start": "random",
    }
    sizes = {"radius": radius, "safe_distance": 5.0, "scan_radius": 50.0}
    finding = Finding(positions=ring, **sizes, **reported, seed=0, run=path.name, episode=0)
    catalogues.write(Catalogue.from_findings([finding]), path)
    return path


def test_what_cannot_be_put_together(tmp_path, capsys):
    three, four = folder_of(tmp_path / "three", 3, 1.0), folder_of(tmp_path / "four", 4, 1.0)
    small, out = folder_of(tmp_path / "small", 3, 0.9), tmp_path / "out"
    refused(capsys, [three, four, "--out", out], "robots = [3, 4]: must be the same number in all findings")
    arguments = [three, small, "--no-scaling", "--tolerance", "1", "--out", out]
    refused(capsys, arguments, "radius = [0.9, 1.0]: must be the same in all findings")
    assert not out.exists()
    assert main(["catalogue", str(three), str(small), "--out", str(out)]) == 0


def test_folders_that_are_no_runs(tmp_path, discovered, capsys):
    refused(capsys, [tmp_path / "none"], "holds no run")
    (tmp_path / "empty").mkdir()
    refused(capsys, [tmp_path / "empty"], "empty holds no run")
    refused(capsys, [], "required: RUN")
    broken = shutil.copytree(discovered, tmp_path / "broken")
    (broken / "trajectories.npz").write_bytes(b"no")
    refused(capsys, [broken, "--out", tmp_path / "x"], "trajectories.npz is not a valid npz file")
    (broken / "evaluation.json").write_text("{}")
    refused(capsys, [broken, "--out", tmp_path / "x"], "evaluation.json lacks")
    summary = json.loads((discovered / "evaluation.json").read_text())
    (broken / "evaluation.json").write_text(json.dumps(summary | {"failures": 3}))
    line = "evaluation.json has failures = 3, which are not episodes: make it again"
    refused(capsys, [broken, "--out", tmp_path / "x"], line)
    foreign = tmp_path / "foreign"
    foreign.mkdir()
    (foreign / "catalogue.json").write_text('{"format": 7}')
    refused(capsys, [foreign, "--out", tmp_path / "x"], f"{foreign / 'catalogue.json'}: ")


def test_no_valid_pattern_is_said(discovered, tmp_path, capsys):
    nothing = shutil.copytree(discovered, tmp_path / "nothing")
    arrays = files.read_npz(nothing / "trajectories.npz")
    arrays["positions"][:, 1:, 0] = 30.0  # outside the world
    RunFolder(nothing).write_evaluation(RunFolder(nothing).evaluation(), arrays)
    refused(capsys, [nothing, "--out", tmp_path / "x"], "no valid pattern was found in")


def test_the_gap_is_in_percent_of_the_best_known(tmp_path, capsys):
    ring = folder_of(tmp_path / "ring", 5, 1.0, value=3.8709, gap=0.0391)
    assert main(["catalogue", str(ring), "--out", str(tmp_path / "out")]) == 0
    assert "1.000%" in capsys.readouterr().out

"""Ten thousand files that somebody broke, by a fixed seed: each reader gives an answer or one line, and never hangs."""

from __future__ import annotations

import os
import random
import shutil
import time
import warnings
from collections import Counter
from pathlib import Path

import pytest
from test_escape import ROW

from murmurate import plots
from murmurate.analysis import Catalogue
from murmurate.analysis.optimum import best_known
from murmurate.analysis.optimum.best_known import BestKnown
from murmurate.discovery import Search
from murmurate.errors import MAX_LINE, InputError, RunError
from murmurate.runs import catalogues, comparison, comparison_page, config_io, experiment, files, jobs, table
from murmurate.runs.evaluate import evaluated
from murmurate.runs.folder import Checkpoint, RunFolder, trained_checksums
from murmurate.runs.grid import Grid
from murmurate.world import read_starts
from tiny import tiny

INPUTS = 10_000
SECONDS = 2.0
"""Time that a single input may take, on a busy machine too."""

NUMBERS = [
    "0",
    "-1",
    "7",
    "1e308",
    "-1e-308",
    "1e999",
    "NaN",
    "9" * 30,
    "9" * 350,
    "9" * 5000,
    "0.5",
    "2147483648",
    "true",
]
JSONS = [
    *NUMBERS,
    "null",
    '"x"',
    '""',
    "[]",
    "{}",
    "[[]]",
    '{"a": 1}',
    '"\\ud800"',
    '"\\u001b[31m"',
    '"=1+1"',
    "[" * 99,
]
WORDS = [
    b"\0",
    b"\xff\xfe",
    b"[/x]",
    b"\x1b]0;x\x07",
    b"<script>",
    b"../../x",
    b"/etc/passwd",
    b"=1",
    b"\n",
    b'"',
    b"]",
]


def mutated(rng, data):
    """Returns data broken in one of the ways in which files break, or are broken by somebody."""
    how = rng.randrange(6)
    if how == 0 and data:  # bits flip
        broken = bytearray(data)
        for _ in range(rng.randrange(1, 9)):
            broken[rng.randrange(len(broken))] ^= 1 << rng.randrange(8)
        return bytes(broken)
    at, to = sorted(rng.randrange(len(data) + 1) for _ in range(2))
    if how == 1:  # cut short
        return data[:at]
    if how == 2:  # a piece is missing
        return data[:at] + data[min(to, at + 40) :]
    if how == 3:  # a piece comes twice
        return data[:to] + data[at:to] + data[to:]
    word = rng.choice([*WORDS, *(number.encode() for number in NUMBERS)])
    return data[:at] + word + data[min(to, at + 3) :]


def mutated_text(rng, text):
    """Returns JSON or TOML in which one value, or one name, is another; sometimes broken as a file."""
    data = text.encode()
    if rng.random() < 0.3:
        return mutated(rng, data)
    marks = [i for i, byte in enumerate(data) if byte in b":=,["]
    at = rng.choice(marks) + 1 if marks else 0
    end = next((i for i in range(at, len(data)) if data[i] in b",]}\n"), len(data))
    return data[:at] + b" " + rng.choice(JSONS).encode() + data[end:]


@pytest.fixture
def readers(finished, tmp_path):
    """For each kind of file: where it lies, what it holds, how it is broken, and what reads it."""
    whole = RunFolder(shutil.copytree(finished, tmp_path / "in" / "whole"))
    # As version 0.1.0 wrote it: checksums keep nobody from forging a run, and here they would hide all other checks.
    run = RunFolder(shutil.copytree(finished, tmp_path / "in" / "run"))
    manifest = run.manifest()
    files.write_json(run.path / "manifest.json", manifest | {"format": 1, "checksums": trained_checksums(manifest)})
    open_run = RunFolder(shutil.copytree(finished, tmp_path / "in" / "open"))
    (open_run.path / "manifest.json").unlink()
    search = Search(tiny())
    snapshot = search.advance(search.begin())[0]
    open_run.write_checkpoint(Checkpoint(snapshot, 2, 1.0))
    board = tmp_path / "in" / "board"
    board.mkdir()
    (board / "metrics.jsonl").write_bytes((finished / "metrics.jsonl").read_bytes())
    tables = tmp_path / "in" / "tables"
    tables.mkdir()
    files.write_json(tables / "comparison.json", {"rows": [ROW, ROW | {"robots": 4, "worst": []}], "commands": ["x"]})
    catalogue = tmp_path / "in" / "catalogue"
    few = catalogues.read_findings(finished)[:3]
    catalogues.write(Catalogue.from_findings(few), catalogue)
    open_toml = open_run.path / "experiment.toml"
    entry = tmp_path / "in" / "entry.json"
    files.write_json(entry, best_known.load()[0].to_dict())
    starts = tmp_path / "in" / "starts.csv"
    starts.write_text("start,x,y\n" + "".join(f"{s},{x},{s}\n" for s in range(3) for x in (0, 5, 9)))
    grid = tmp_path / "in" / "sweep.toml"
    grid.write_text('experiments = ["A", "B"]\nseeds = 2\n[grid]\n"base.ppo.clip" = [0.1, 0.2]\n')

    def show_rows():
        rows = comparison.sorted_rows(tables)
        comparison_page.page(rows, comparison.load(tables)["commands"])

    return {
        "comparison": (tables / "comparison.json", mutated_text, show_rows, 5),
        "metrics": (run.path / "metrics.jsonl", mutated_text, lambda: plots.Recording.open(run), 3),
        "entry": (entry, mutated_text, lambda: BestKnown.from_dict(files.read_json(entry)), 4),
        "board": (board / "metrics.jsonl", mutated_text, lambda: jobs.TrainingJob(board, tiny()).progress(), 4),
        "evaluation": (run.path / "evaluation.json", mutated_text, lambda: evaluated(run), 4),
        "table": (run.path / "evaluation.json", mutated_text, lambda: table.results([run.path]), 2),
        "npz": (run.path / "trajectories.npz", mutated, lambda: run.trajectories(tiny()), 4),
        "manifest": (
            whole.path / "manifest.json",
            mutated_text,
            lambda: (whole.verify(), table.results([whole.path])),
            4,
        ),
        "catalogue": (catalogue / "catalogue.json", mutated_text, lambda: catalogues.read_findings(catalogue), 4),
        "checkpoint": (
            open_run.path / "checkpoint" / "snapshot.safetensors",
            mutated,
            lambda: (open_run.checkpoint_rows(), open_run.checkpoint(search)),
            2,
        ),
        "policy": (run.path / "policies" / "0-base.safetensors", mutated, run.verify, 1),
        "experiment": (open_run.path / "experiment.toml", mutated_text, open_run.experiment, 4),
        "toml": (open_toml, mutated, lambda: experiment.read_toml(open_toml), 2),
        "sweep": (grid, mutated_text, lambda: config_io.load_toml(grid), 1),
        "grid": (grid, mutated_text, lambda: Grid.from_toml(grid), 0.1),
        "starts": (starts, mutated, lambda: read_starts(starts, 3), 2),
    }


def contents(folder):
    return {path: path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


@pytest.mark.nightly
@pytest.mark.unchecked
def test_every_reader_refuses_in_one_line_what_it_cannot_read(readers, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(os, "fsync", lambda descriptor: None)  # of files that live for a moment
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "x").write_text("mine")
    rng, total = random.Random(1), sum(share for *_, share in readers.values())
    read, refused = Counter(), Counter()
    failures: dict[str, tuple[str, bytes]] = {}
    for kind, (path, mutate, reader, share) in readers.items():
        good, neighbours = path.read_bytes(), contents(path.parent)
        source = good if mutate is mutated else good.decode()
        reader()  # compiles what checks need
        for _ in range(round(INPUTS * share / total)):
            path.write_bytes(mutate(rng, source))
            begun = time.perf_counter()
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("error")
                    reader()
                read[kind] += 1
            except (InputError, RunError) as error:
                refused[kind] += 1
                line = str(error)
                if len(line) > MAX_LINE or not line.isprintable():
                    failures.setdefault(f"{kind}: not a short line: {line}", (line, path.read_bytes()))
            except OSError as error:  # of files that the user names: the command line says it in one line
                if kind not in ("toml", "sweep", "grid"):
                    failures.setdefault(f"{kind}: {error!r}", ("", path.read_bytes()))
            except Exception as error:
                trace = error.__traceback__
                while trace is not None and trace.tb_next is not None:
                    trace = trace.tb_next
                where = f"{trace.tb_frame.f_code.co_filename}:{trace.tb_lineno}" if trace else ""
                failures.setdefault(f"{kind}: {type(error).__name__} {where}", (str(error)[:300], path.read_bytes()))
            if time.perf_counter() - begun > SECONDS:
                failures.setdefault(f"{kind}: took {time.perf_counter() - begun:.1f} s", ("", path.read_bytes()))
        for neighbour, data in neighbours.items():
            neighbour.write_bytes(data)
        reader()  # as it was before
    assert not failures, "\n".join(f"{what}: {error}" for what, (error, _) in failures.items())
    assert sum(read.values()) + sum(refused.values()) > 0.99 * INPUTS
    assert set(refused) == readers.keys() - {"board"}  # which leaves out what it cannot show
    assert contents(outside) == {outside / "x": b"mine"}
    assert {path.name for path in tmp_path.iterdir()} == {"in", "outside"}

"""Trains the weights that come with the package anew: `make pretrained` (two hours on two cores).

python -m benchmarks.pretrained [--runs runs] [--only-finished]

Each folder of src/murmurate/pretrained holds the experiment.toml that its weights are trained by. Where there is a
recipe of its name in benchmarks/recipes, that is trained first: reinforcement learning discovers what gradients then
refine. Trainings run two at a time; what is finished in the runs folder is reused.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from murmurate.cli.main import NOTHING_VALID, TOO_FEW_VALID
from murmurate.runs import experiment, files
from murmurate.runs.folder import MANIFEST, METRICS, RunFolder
from murmurate.runs.pretrained import FOLDER

RECIPES = Path(__file__).parent / "recipes"

AT_ONCE = 2
"""Trainings at a time: each keeps one core busy."""

EVERY = 10
"""Of the metrics, the package holds one row in so many: enough to draw how training went."""


def train(trainings: Iterable[tuple[Path, Path, Path | None]]) -> None:
    """Trains, a few at a time, each an experiment to a folder, from the policy of a finished run or from none."""

    def run(training: tuple[Path, Path, Path | None]) -> None:
        recipe, folder, initial = training
        command = ["discover", str(recipe), "--out", str(folder), "--resume", "--quiet"]
        print(f"training {folder.name}", flush=True)
        result = subprocess.run(
            [sys.executable, "-m", "murmurate", *command, *([] if initial is None else ["--from", str(initial)])],
            check=False,
        )
        # What is refined need not be valid everywhere before.
        if result.returncode not in (0, NOTHING_VALID, TOO_FEW_VALID):
            raise SystemExit(result.returncode)

    with ThreadPoolExecutor(AT_ONCE) as threads:
        list(threads.map(run, trainings))


def pack(folder: Path, to: Path) -> None:
    """Copies what the package needs of a run: not its evaluation, and not the kernel of the machine that trained it."""
    run, copy = RunFolder(folder), RunFolder(to)
    manifest = run.verify()
    names = [name for name in manifest["checksums"] if name == experiment.EXPERIMENT or name.startswith("policies/")]
    for name in names:
        files.make_folder((to / name).parent)
        files.write_bytes(to / name, (folder / name).read_bytes())
    (to / METRICS).unlink(missing_ok=True)
    copy.append_metrics(run.metrics()[EVERY - 1 :: EVERY])
    checksums = {name: manifest["checksums"][name] for name in names}
    platform_name = f"{platform.system()} {platform.machine()}"
    files.write_json(to / MANIFEST, {**manifest, "platform": platform_name, "checksums": checksums})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where the runs are kept")
    parser.add_argument("--only-finished", action="store_true", help="train nothing, pack what is finished")
    options = parser.parse_args()
    folders = sorted(path.parent for path in FOLDER.glob(f"*/*/{experiment.EXPERIMENT}"))
    names = {to: f"{to.parent.name}-{to.name}" for to in folders}
    trained = {to: options.runs / f"pretrained-{name}" for to, name in names.items()}
    recipes = {to: path for to, name in names.items() if (path := RECIPES / f"{name}.toml").exists()}
    discovered = {to: options.runs / f"discovered-{names[to]}" for to in recipes}
    if not options.only_finished:
        train((recipe, discovered[to], None) for to, recipe in recipes.items())
        train((to / experiment.EXPERIMENT, run, discovered.get(to)) for to, run in trained.items())
    for to, run in trained.items():
        pack(run, to)
        print(f"packed {run.name}: {sum(path.stat().st_size for path in to.rglob('*') if path.is_file())} bytes")


if __name__ == "__main__":
    main()

"""Trains the weights that come with the package anew: `make pretrained` (two hours on two cores).

python -m benchmarks.pretrained [--runs runs] [--only-finished]

Each folder of src/murmurate/pretrained holds the experiment.toml that its weights are trained by. Where there is a
recipe of its name in benchmarks/recipes, that is trained first: reinforcement learning discovers what gradients then
refine. Trainings run two at a time; what is finished in the runs folder is reused.
"""

from __future__ import annotations

import argparse
import platform
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path

from murmurate.runs import presets
from murmurate.runs.execute import LocalProcesses, run_jobs
from murmurate.runs.experiment import ExperimentConfig
from murmurate.runs.folder import RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.pretrained import CARD, FOLDER
from murmurate.runs.run import Run

RECIPES = Path(__file__).parent / "recipes"

AT_ONCE = 2
"""Trainings at a time: each keeps one core busy."""

EVERY = 10
"""Of the metrics, the package holds one row in so many: enough to draw how training went."""


def train(experiments: Mapping[str, ExperimentConfig], runs: Path, initial: Mapping[str, Path]) -> None:
    """Trains, a few at a time, what is not finished.

    Args:
        experiments: The experiments, by the names of their run folders.
        runs: The folder of all runs.
        initial: The finished runs whose policies some of them begin with, by the same names.
    """
    grid = Grid(experiments)
    grid.check(runs)
    begun_with = {name: Run.open(folder) for name, folder in initial.items()}
    statuses = run_jobs(training_jobs(grid, runs, initial=begun_with), LocalProcesses(AT_ONCE, retries=0))
    failed = [f"{name}: {status.error}" for name, status in statuses.items() if status.state == "failed"]
    if failed:
        raise SystemExit("\n".join(failed))


def pack(run: RunFolder, to: Path) -> None:
    """Puts what the package needs of a run in place of the weights in a folder, whose card stays.

    That is not its evaluation, and not the kernel of the machine that trained it.
    """
    system = f"{platform.system()} {platform.machine()}"
    with tempfile.TemporaryDirectory(dir=to.parent) as folder:
        copy = run.copy_to(Path(folder) / to.name, metrics_every=EVERY, changes={"platform": system})
        shutil.copyfile(to / CARD, copy.path / CARD)
        shutil.rmtree(to)
        copy.path.rename(to)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where the runs are kept")
    parser.add_argument("--only-finished", action="store_true", help="train nothing, pack what is finished")
    options = parser.parse_args()
    folders = {f"{path.parent.name}-{path.name}": path for path in sorted(FOLDER.glob("*/*"))}
    recipes = {name: path for name in folders if (path := RECIPES / f"{name}.toml").exists()}
    if not options.only_finished:
        discoveries = {f"discovered-{name}": presets.resolve(path) for name, path in recipes.items()}
        train(discoveries, options.runs, {})
        train(
            {f"pretrained-{name}": RunFolder(path).experiment() for name, path in folders.items()},
            options.runs,
            {f"pretrained-{name}": options.runs / f"discovered-{name}" for name in recipes},
        )
    for name, path in folders.items():
        pack(RunFolder(options.runs / f"pretrained-{name}"), path)
        size = sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
        print(f"packed pretrained-{name}: {size} bytes")


if __name__ == "__main__":
    main()

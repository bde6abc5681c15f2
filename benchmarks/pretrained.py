"""Trains the weights that come with the package anew: `make pretrained` (two hours on one core).

python -m benchmarks.pretrained [--runs runs] [--only-finished]

Each folder of src/murmurate/pretrained holds the experiment.toml that its weights are trained by; what is finished in
the runs folder is reused.
"""

from __future__ import annotations

import argparse
import platform
from pathlib import Path

from murmurate.runs import experiment, storage
from murmurate.runs.execute import InProcess, run_jobs
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.pretrained import FOLDER
from murmurate.runs.run import METRICS, Run

EVERY = 10
"""Of the metrics, the package holds one row in so many: enough to draw how training went."""


def pack(folder: Path, to: Path) -> None:
    """Puts what is needed of a run into the package."""
    run = Run.open(folder)
    for name in run.manifest["checksums"]:
        storage.make_folder((to / name).parent)
        storage.write_bytes(to / name, (folder / name).read_bytes())
    rows = (folder / METRICS).read_text("utf-8").splitlines(keepends=True)
    storage.write_text(to / METRICS, "".join(rows[EVERY - 1 :: EVERY]))
    # Not the kernel of the machine that happened to train them.
    kept = {**run.manifest, "platform": f"{platform.system()} {platform.machine()}"}
    storage.write_json(to / storage.MANIFEST, kept)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where the runs are kept")
    parser.add_argument("--only-finished", action="store_true", help="train nothing, pack what is finished")
    options = parser.parse_args()
    folders = sorted(path.parent for path in FOLDER.glob(f"*/*/{storage.EXPERIMENT}"))
    names = {f"pretrained-{to.parent.name}-{to.name}": to for to in folders}
    if not options.only_finished:
        grid = Grid({name: experiment.load(to) for name, to in names.items()})
        run_jobs(training_jobs(grid, options.runs), InProcess())
    for name, to in names.items():
        pack(options.runs / name, to)
        print(f"packed {name}: {sum(path.stat().st_size for path in to.rglob('*') if path.is_file())} bytes")


if __name__ == "__main__":
    main()

"""Trains the weights that come with the package anew: `make pretrained` (two hours on one core).

python -m benchmarks.pretrained [--runs runs] [--only-finished]

Each folder of src/murmurate/pretrained holds the experiment.toml that its weights are trained by; what is finished in
the runs folder is reused.
"""

from __future__ import annotations

import argparse
import platform
from pathlib import Path

from murmurate.runs import experiment, files
from murmurate.runs.execute import InProcess, run_jobs
from murmurate.runs.folder import MANIFEST, METRICS, RunFolder
from murmurate.runs.grid import Grid
from murmurate.runs.jobs import training_jobs
from murmurate.runs.pretrained import FOLDER

EVERY = 10
"""Of the metrics, the package holds one row in so many: enough to draw how training went."""


def pack(folder: Path, to: Path) -> None:
    """Copies what the package needs of a run."""
    run, copy = RunFolder(folder), RunFolder(to)
    manifest = run.verify()
    for name in manifest["checksums"]:
        files.make_folder((to / name).parent)
        files.write_bytes(to / name, (folder / name).read_bytes())
    (to / METRICS).unlink(missing_ok=True)
    copy.append_metrics(run.metrics()[EVERY - 1 :: EVERY])
    # Not the kernel of the machine that happened to train them.
    platform_name = f"{platform.system()} {platform.machine()}"
    files.write_json(to / MANIFEST, {**manifest, "platform": platform_name})


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, default=Path("runs"), help="where the runs are kept")
    parser.add_argument("--only-finished", action="store_true", help="train nothing, pack what is finished")
    options = parser.parse_args()
    folders = sorted(path.parent for path in FOLDER.glob(f"*/*/{experiment.EXPERIMENT}"))
    names = {f"pretrained-{to.parent.name}-{to.name}": to for to in folders}
    if not options.only_finished:
        grid = Grid({name: experiment.load(to) for name, to in names.items()})
        run_jobs(training_jobs(grid, options.runs), InProcess())
    for name, to in names.items():
        pack(options.runs / name, to)
        print(f"packed {name}: {sum(path.stat().st_size for path in to.rglob('*') if path.is_file())} bytes")


if __name__ == "__main__":
    main()

"""Trains the weights that come with the package anew: `make pretrained` (two hours on one core).

python -m benchmarks.pretrained [--runs runs] [--only-finished]

Each folder of src/murmurate/pretrained holds the experiment.toml that its weights are trained by; what is finished in
the runs folder is reused.
"""

from __future__ import annotations

import argparse
import platform
import subprocess
import sys
from pathlib import Path

from murmurate.runs import storage
from murmurate.runs.pretrained import FOLDER
from murmurate.runs.run import METRICS, Run

EVERY = 10
"""Of the metrics, the package holds one row in so many: enough to draw how training went."""


def train(experiment: Path, folder: Path) -> None:
    """Runs one experiment, or goes on with it."""
    words = ["discover", str(experiment), "--out", str(folder), "--resume"]
    done = subprocess.run([sys.executable, "-m", "murmurate", *words], check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(done.returncode)


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
    for to in sorted(path.parent for path in FOLDER.glob(f"*/*/{storage.EXPERIMENT}")):
        name = f"{to.parent.name}-{to.name}"
        folder = options.runs / f"pretrained-{name}"
        if not options.only_finished:
            train(to / storage.EXPERIMENT, folder)
        pack(folder, to)
        print(f"packed {name}: {sum(path.stat().st_size for path in to.rglob('*') if path.is_file())} bytes")


if __name__ == "__main__":
    main()

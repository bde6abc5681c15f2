"""Tries an installed murmurate outside of its checkout, with nothing but what its wheel installs: see `make dist`."""

import subprocess
import sys
from pathlib import Path

import murmurate

assert Path(murmurate.__file__).is_relative_to(sys.prefix), f"{murmurate.__file__} is not the installed package"
for objective in ("C1", "C2"):
    for sensing in ("global", "visible"):
        run = murmurate.pretrained(objective, sensing)
        assert (run.folder / "README.md").is_file(), f"the weights of {objective}, {sensing} have no card"
        run = run.of_size(5)
        trajectories = run.rollout(starts=4, key=1)
        validity = murmurate.check_validity(trajectories, run.experiment.world)
        assert validity.contact_free.all(), f"contact with the weights of {objective}, {sensing}"
        print(f"{objective}, {sensing}: {validity.valid.sum()} of 4 patterns are valid")
subprocess.run([sys.executable, "-m", "murmurate", "experiments"], check=True)

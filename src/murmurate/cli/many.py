"""`murmurate discover --seeds K`: many discoveries of one experiment, and one catalogue of what they found."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from murmurate.analysis import Catalogue
from murmurate.errors import InputError, check_number, suggestion
from murmurate.runs import catalogues, config_io, storage, table
from murmurate.runs.experiment import MAX_SEED, ExperimentConfig, check_same

__all__ = ["discover_many", "variants"]

NOTHING_VALID = 3
MOST = 10_000


def variants(config: ExperimentConfig, seeds: int, vary: Sequence[str]) -> dict[str, ExperimentConfig]:
    """Returns the experiments to run, by what tells their folders apart.

    Args:
        config: What they have in common, and the first seed.
        seeds: How many seeds.
        vary: Fields and their values, each as `FIELD=VALUE,...`; all combinations are run.

    Raises:
        InputError: A field is unknown, or a value is not allowed.
    """
    check_number("--seeds", seeds, 1, MOST, integer=True)
    if config.seed + seeds - 1 > MAX_SEED:
        raise InputError("--seeds", seeds, f"at most {MAX_SEED - config.seed + 1}: seeds end at {MAX_SEED}")
    leaves = {leaf.path: leaf for leaf in config_io.leaves(config)}
    choices = [_choices(text, leaves) for text in vary]
    found = {}
    for seed in range(config.seed, config.seed + seeds):
        for values in itertools.product(*choices):
            given = {path: config_io.parse(leaves[path].kind, text, path) for path, text in values}
            label = "".join(f"-{path.rpartition('.')[2]}{text}" for path, text in values)
            found[f"seed{seed}{label}"] = replace(config_io.replaced(config, config_io.nested(given)), seed=seed)
    return found


def _choices(text: str, leaves: Mapping[str, Any]) -> list[tuple[str, str]]:
    path, equals, values = text.partition("=")
    if path not in leaves or path == "seed":
        raise InputError("--vary", text, f"FIELD=VALUE,... with a field of the experiment{suggestion(path, leaves)}")
    texts = [value.strip() for value in values.split(",")]
    if not equals or not all(texts) or len(set(texts)) < len(texts):
        raise InputError("--vary", text, "FIELD=VALUE,... with one or more values, none of them twice")
    return [(path, value) for value in texts]


def discover_many(
    configs: Mapping[str, ExperimentConfig],
    out: Path,
    name: str,
    resume: bool,
    together: int | None = None,
    on_metrics: Callable[[Path], None] | None = None,
) -> int:
    """Runs experiments, each to a folder of its own, and catalogues what they found.

    Args:
        configs: The experiments, by what tells their folders apart.
        out: The folder of all runs.
        name: What their folders are called, but for that.
        resume: Go on with the runs that are there already.
        together: How many train side by side in one program; by default all on an accelerator, and one on a CPU,
            which loses by it.
        on_metrics: See `experiments.training.discover`.

    Returns:
        0, or 3 when no valid pattern was discovered.

    Raises:
        InputError: `together` is out of bounds.
    """
    import jax

    from murmurate.cli.catalogue import show
    from murmurate.cli.progress import Progress
    from murmurate.runs.train import discover_together

    if together is None:
        together = 1 if jax.default_backend() == "cpu" else len(configs)
    check_number("--together", together, 1, MOST, integer=True)
    folders = {out / f"{name}-{label}": config for label, config in configs.items()}
    catalogue = out / f"{name}-catalogue"
    catalogues.look(catalogue)
    for folder, config in folders.items():
        if storage.look(folder, resume) != "new":
            check_same(config, folder)
    for first in range(0, len(folders), together):
        part = dict(itertools.islice(folders.items(), first, first + together))
        numbers = f"{first + 1}" if len(part) == 1 else f"{first + 1}-{first + len(part)}"
        try:
            with Progress() as progress:
                tell = _numbered(progress.update, f"{numbers} of {len(folders)}: ")
                discover_together(part, resume, tell, on_metrics)
        except KeyboardInterrupt:
            raise KeyboardInterrupt("interrupted; add --resume to the same command to go on") from None
    print(table.as_markdown(table.RESULTS, table.results(folders)), end="")
    found = [finding for folder in folders for finding in catalogues.findings(folder)]
    if not found:
        print(f"No valid pattern was discovered. The runs are kept in {out}.")
        return NOTHING_VALID
    show(Catalogue.from_findings(found), catalogue)
    return 0


def _numbered(update: Any, prefix: str) -> Any:
    """Puts the number of a run, or of several, before what the progress line tells."""
    return lambda work, *args, **values: update(prefix + work, *args, **values)

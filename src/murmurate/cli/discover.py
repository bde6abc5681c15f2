"""`murmurate discover`: trains the policies of an experiment, evaluates them and draws what they form."""

from __future__ import annotations

import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path

from murmurate.cli.arguments import Parser
from murmurate.cli.attended import go_on_attended
from murmurate.errors import RunError, UsageError
from murmurate.runs.paper import EXPERIMENTS, check_experiment

__all__ = ["run"]

NOTHING_VALID = 3


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0, or 3 when no valid pattern was discovered.
    """
    word = argv[0] if argv and not argv[0].startswith("-") else None
    if word is not None:
        check_experiment(word)  # before JAX is loaded
    if any(given.partition("=")[0] == "--hosts" for given in argv):
        go_on_attended()
    from murmurate.cli.progress import Progress
    from murmurate.learning import hosts
    from murmurate.runs import presets
    from murmurate.runs.experiment import read_toml
    from murmurate.runs.train import discover

    options, flags = _parser(word if word in EXPERIMENTS else "C").parse(argv)
    _join(options)
    overlay = read_toml(options.config) if options.config else {}
    config = presets.resolve(options.experiment, overlay, flags, learner=options.learner)
    name = f"{config.name}-{options.learner or config.policy.name}"
    if options.seeds is not None or options.vary:
        from murmurate.cli.many import discover_many, variants

        configs = variants(config, options.seeds if options.seeds is not None else 1, options.vary)
        with _events(options.tensorboard) as events:
            out = Path(options.out or "runs")
            return discover_many(configs, out, name, options.resume, options.together, events)
    if options.together is not None:
        raise UsageError("--together is for many runs: it needs --seeds or --vary")
    folder = Path(options.out or Path("runs") / f"{name}-seed{config.seed}")
    try:
        if not hosts.is_first():
            discover(config, folder, options.resume)
            return 0
        with Progress() as progress, _events(options.tensorboard) as events:
            discover(config, folder, options.resume, progress.update, events)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"interrupted; add --resume to the same command to go on with {folder}") from None
    return _report(folder)


def _parser(shown: str) -> Parser:
    from murmurate.runs import presets

    parser = Parser("discover", "EXPERIMENT", "Trains the policies of an experiment, evaluates and draws them.")
    parser.add_argument("experiment", metavar="EXPERIMENT", help=f"{', '.join(EXPERIMENTS)}, or a TOML file")
    parser.add_argument("--out", metavar="DIR", help="run folder (default: runs/EXPERIMENT-LEARNER-seedSEED)")
    parser.add_argument("--config", metavar="FILE", help="TOML file of fields to replace; flags win over it")
    names = ",".join(presets.TRAINING_PRESETS)
    text = "whose numbers to begin with (default: those of the policy)"
    parser.add_argument("--learner", metavar=f"{{{names}}}", help=text)
    parser.add_argument("--resume", action="store_true", help="continue the run that the folder holds")
    many = "train this many seeds, from --seed on, and catalogue what they find; --out is then the folder of all"
    parser.add_argument("--seeds", type=int, metavar="INT", help=many)
    vary = "with every seed, train with each of these values; may be given for several fields"
    parser.add_argument("--vary", action="append", default=[], metavar="FIELD=VALUE,...", help=vary)
    side = "train this many of them side by side in one program (default: all on an accelerator, 1 on a CPU)"
    parser.add_argument("--together", type=int, metavar="INT", help=side)
    board = "write the training curves for TensorBoard as well (needs the tensorboard extra)"
    parser.add_argument("--tensorboard", action="store_true", help=board)
    text = "train on this many hosts, each of which runs the same command with its own --host; or auto, as Slurm says"
    parser.add_argument("--hosts", metavar="INT|auto", help=text)
    parser.add_argument("--host", type=int, metavar="INT", help="which of them this is, from 0, which keeps the run")
    text = "where the first of them listens, a free port of its own"
    parser.add_argument("--coordinator", metavar="HOST:PORT", help=text)
    parser.add_fields(presets.preset(shown), aliases={"policy.use": "--policy"})
    parser.epilog = f"Defaults are those of experiment {shown} with the {presets.DEFAULT_LEARNER} learner."
    return parser


def _join(options: Namespace) -> None:
    """Makes this process one of several hosts, where it was asked for."""
    if options.hosts is None:
        if options.host is not None or options.coordinator is not None:
            raise UsageError("--host and --coordinator go with --hosts")
        return
    if options.seeds is not None or options.vary:
        raise UsageError("--hosts is for one run, and --seeds and --vary are for many (see murmurate sweep)")
    from murmurate.learning import hosts

    if options.hosts == "auto":
        if options.host is not None or options.coordinator is not None:
            raise UsageError("--hosts auto finds out by itself what --host and --coordinator say")
        hosts.join(None, None, None)
        return
    for name in ("host", "coordinator"):
        if getattr(options, name) is None:
            raise UsageError(f"--hosts {options.hosts} needs --{name} as well")
    count = int(options.hosts) if options.hosts.isdecimal() else options.hosts
    hosts.check(options.coordinator, count, options.host)
    if options.host == 0 and count > 1:
        print(f"waiting for the other hosts at {options.coordinator}", file=sys.stderr, flush=True)
    hosts.join(options.coordinator, count, options.host)


def _events(wanted: bool) -> AbstractContextManager[Callable[[Path], None] | None]:
    """Opens what writes events for TensorBoard, or nothing."""
    if not wanted:
        return nullcontext()
    try:
        from murmurate.interop.tensorboard import Events
    except ModuleNotFoundError as error:
        raise UsageError(str(error)) from None
    return Events()


def _report(folder: Path) -> int:
    """Prints and draws a finished run."""
    from murmurate.cli import outcome
    from murmurate.runs import experiment as configuration
    from murmurate.runs import presets, storage, table
    from murmurate.runs.train import VALID

    config, summary = configuration.load(folder), table.read_evaluation(folder)
    outcome.print_comparison(summary, presets.paper_row(config))
    outcome.print_record(folder)
    failed = storage.read_manifest(folder).get("outcome") != VALID
    try:
        print(f"picture: {outcome.draw(folder)}")
    except RunError as error:
        if not failed:
            raise
        print(f"no picture: {error}")  # policies that went astray may leave nothing to draw
    if failed:
        print(f"No valid pattern was discovered. The run is kept in {folder}; try another --seed or more updates.")
        return NOTHING_VALID
    print(f"animation: murmurate show {folder}")
    print(f"other starts: murmurate evaluate {folder} --seed 1 --out {folder}-evaluation")
    return 0

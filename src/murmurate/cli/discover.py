"""`murmurate discover`: trains the policies of an experiment, evaluates them and draws what they form."""

from __future__ import annotations

import functools
import sys
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from itertools import zip_longest
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser, chosen_strategies
from murmurate.cli.main import NOTHING_VALID, STATUS, TOO_FEW_VALID
from murmurate.errors import MAX_INTEGER, UsageError, check_number
from murmurate.runs.paper import ALLOWED, check_experiment
from murmurate.terminal import say

if TYPE_CHECKING:
    from murmurate.runs.experiment import ExperimentConfig
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.run import Run

__all__ = ["run"]

EVERYDAY = (
    "--out",
    "--config",
    "--resume",
    "--quiet",
    "--seed",
    "--seeds",
    "--diverse",
    "--vary",
    "--objective",
    "--policy",
    "--start.use",
    "--world.robots",
    "--base.gradients.updates",
)
"""The flags that --help shows; --help-all shows the rest, one for every field of an experiment."""


def run(argv: Sequence[str]) -> int:
    """Runs the verb.

    Returns:
        0; 3 when no valid pattern was discovered; 5 when there are fewer than discovery.required_valid asks for.
    """
    word = argv[0] if argv and not argv[0].startswith("-") else None
    if word is not None:
        check_experiment(word)  # before JAX is loaded
    from murmurate.cli.progress import Progress
    from murmurate.learning import sharding
    from murmurate.runs import catalogues, presets
    from murmurate.runs.experiment import read_toml
    from murmurate.runs.folder import RunFolder
    from murmurate.runs.grid import Grid, run_name
    from murmurate.runs.pretrained import run_folder
    from murmurate.runs.run import Run
    from murmurate.runs.train import discover

    options, flags = _parser(word, argv).parse(argv)
    _join(options)
    overlay = read_toml(options.config) if options.config else {}
    build = functools.partial(
        presets.resolve,
        options.experiment,
        overlay,
        flags,
        learner=options.learner,
        default=_default_learner(argv),
        folders=_module_folders(options.config),
    )
    config = build()
    if options.diverse is not None:
        _check_diverse(options, config)
    name = run_name(config.name, options.learner or config.policy.name)
    initial = None if options.initial is None else Run.open(run_folder(options.initial), options.trust)
    if options.seeds is not None or options.vary:
        from murmurate.cli.many import discover_many

        grid = Grid.from_flags(config, name, options.seeds if options.seeds is not None else 1, options.vary, build)
        with _events(options.tensorboard) as events:
            out = Path(options.out or "runs")
            return discover_many(grid, out, name, options.resume, options.together, events, options.quiet, initial)
    if options.together is not None:
        raise UsageError("--together is for many runs: it needs --seeds or --vary")
    folder = RunFolder(options.out or Path("runs") / run_name(name, f"seed{config.seed}"))
    if options.diverse is not None:
        catalogues.check_target(_patterns_folder(folder))  # before anything is trained
    try:
        if not sharding.is_first():
            discover(config, folder.path, options.resume, initial=initial)
            return 0
        with Progress(quiet=options.quiet) as progress, _events(options.tensorboard) as events:
            discovered = discover(config, folder.path, options.resume, progress.update, events, initial)
    except KeyboardInterrupt:
        text = f"interrupted; add --resume to the same command to go on with {folder.path}"
        raise KeyboardInterrupt(text) from None
    status = _print_results(discovered, folder)
    if options.diverse is not None and status != NOTHING_VALID:
        _form_each(discovered, folder, options.diverse, options.quiet)
    return status


def _patterns_folder(folder: RunFolder) -> Path:
    """Returns where the patterns that a run remembers are catalogued."""
    return Path(f"{folder.path}-patterns")


def _default_learner(argv: Sequence[str]) -> str | None:
    """Returns the training preset that the flags need where they name none, nor a policy; None for the usual one."""
    names = {word.partition("=")[0] for word in argv}
    if "--diverse" in names:
        return "formation"
    return "equivariant" if "--sizes" in names else None


def _check_diverse(options: Namespace, config: ExperimentConfig) -> None:
    """Refuses a number of patterns that is none, or that cannot be discovered so."""
    check_number("--diverse", options.diverse, 1, MAX_INTEGER, integer=True)
    if not config.policy.has_goals:
        raise UsageError(f"--diverse needs the policy formation: {config.policy.name} remembers no formations")
    if options.seeds is not None or options.vary:
        raise UsageError("--diverse is for one run: give it without --seeds and --vary")


def _form_each(run: Run, folder: RunFolder, count: int, quiet: bool) -> None:
    """Catalogues the patterns that a run remembers, and lets swarms form the best ones."""
    from rich.console import Console

    from murmurate.cli.catalogue import show
    from murmurate.cli.progress import Progress
    from murmurate.runs import formations, sweep, table

    out = _patterns_folder(folder)
    patterns = run.remembered()
    with Progress(quiet=quiet) as progress:
        formed = formations.form_each(run, patterns.classes[:count], on_progress=progress.update)
    show(patterns, out)
    rows = [each.row() for each in formed]
    sweep.write_csv(out / "formed.csv", [dict(zip(formations.FORMED_HEADER, row, strict=True)) for row in rows])
    Console().print(table.as_rich(formations.FORMED_HEADER, rows))
    found = len(patterns.classes)
    lacking = "" if found >= count else f"; {count} were asked for: try more --policy.formations"
    say(f"{found} distinct patterns were discovered; swarms were told to form the best {len(formed)}{lacking}")
    say(
        f"formed: {out / 'formed.csv'}; to form one: murmurate evaluate {folder.path} --pattern {len(formed)} --out DIR"
    )


def _module_folders(config: str | None) -> list[Path]:
    """Returns where the modules of "module:Class" are looked for besides the experiment's own folder."""
    return [*([Path(config).parent] if config else []), Path.cwd()]


def _parser(word: str | None, argv: Sequence[str]) -> Parser:
    """Builds the parser: its flags are the fields of the strategies that the command line and its files choose."""
    from murmurate.runs import presets
    from murmurate.runs.config_io import leaves
    from murmurate.runs.experiment import read_toml

    parser = Parser(
        "discover", "EXPERIMENT", "Trains the policies of an experiment, evaluates and draws them.", EVERYDAY
    )
    parser.add_argument("experiment", metavar="EXPERIMENT", help=ALLOWED)
    parser.add_argument("--out", metavar="DIR", help="run folder (default: runs/EXPERIMENT-LEARNER-seedSEED)")
    parser.add_argument("--config", metavar="FILE", help="TOML file of fields to replace; flags win over it")
    names = ",".join(presets.TRAINING_PRESETS)
    text = "training preset (default: that of the policy; formation for A to F, equivariant for others)"
    parser.add_argument("--learner", metavar=f"{{{names}}}", help=text)
    parser.add_argument("--resume", action="store_true", help="continue the run that the folder holds")
    text = (
        "begin with the policies of this run, of the same shapes, instead of new ones; with --seeds, each of them; or "
        "with the package's weights, such as C2-visible"
    )
    parser.add_argument("--from", dest="initial", metavar="RUN", help=text)
    text = "import the modules that the run of --from names, which executes them"
    parser.add_argument("--trust", action="store_true", help=text)
    parser.add_argument("--quiet", action="store_true", help="do not show the progress")
    text = "catalogue the distinct patterns that the policy formation remembers, and form the best INT from 50 starts"
    parser.add_argument("--diverse", type=int, metavar="INT", help=text)
    many = "train this many seeds, from --seed on, and catalogue what they find; --out is then the folder of all"
    parser.add_argument("--seeds", type=int, metavar="INT", help=many)
    vary = "with every seed, train with each of these values; may be given for several fields"
    parser.add_argument("--vary", action="append", default=[], metavar="FIELD=VALUE,...", help=vary)
    side = "train this many of them side by side in one program (default: all on an accelerator, 1 on a CPU)"
    parser.add_argument("--together", type=int, metavar="INT", help=side)
    board = "write the training curves for TensorBoard as well (needs the tensorboard extra)"
    parser.add_argument("--tensorboard", action="store_true", help=board)
    text = "train on this many hosts; each runs the same command with its own --host (auto: ask Slurm or Open MPI)"
    parser.add_argument("--hosts", metavar="INT|auto", help=text)
    parser.add_argument("--host", type=int, metavar="INT", help="index of this host, from 0; host 0 writes the run")
    text = "address and free port where host 0 listens"
    parser.add_argument("--coordinator", metavar="HOST:PORT", help=text)
    aliases = {"policy.use": "--policy"}
    given = {flag: _value(argv, flag) for flag in ("--config", "--learner")}
    overlay = read_toml(given["--config"]) if given["--config"] else {}
    shown = presets.resolve(
        word or "C",
        overlay,
        chosen_strategies(argv, aliases),
        learner=given["--learner"],
        default=_default_learner(argv),
        folders=_module_folders(given["--config"]),
    )
    parser.add_fields(shown, aliases, skip=[leaf.path for leaf in leaves(shown) if leaf.path.startswith("modules.")])
    defaults = f"Defaults are those of experiment {word or 'C'}. A class of your own: --start.use module:Class."
    parser.epilog = f"{defaults} {STATUS}"
    return parser


def _value(argv: Sequence[str], flag: str) -> str | None:
    """Returns the value of a flag, before the command line is parsed."""
    for word, following in zip_longest(argv, argv[1:], fillvalue=""):
        name, equals, text = word.partition("=")
        if name == flag:
            return text if equals else following or None
    return None


def _join(options: Namespace) -> None:
    """Connects this process with the other hosts, if --hosts asks for it."""
    if options.hosts is None:
        if options.host is not None or options.coordinator is not None:
            raise UsageError("--host and --coordinator go with --hosts")
        return
    if options.seeds is not None or options.vary:
        raise UsageError("--hosts is for one run, and --seeds and --vary are for many (see murmurate sweep)")
    if options.diverse is not None:
        raise UsageError("--hosts is for training: train first, then give --diverse with --resume on one host")
    from murmurate.learning import sharding

    if options.hosts == "auto":
        if options.host is not None or options.coordinator is not None:
            raise UsageError("--hosts auto needs neither --host nor --coordinator")
        sharding.initialize()
        return
    for name in ("host", "coordinator"):
        if getattr(options, name) is None:
            raise UsageError(f"--hosts {options.hosts} needs --{name} as well")
    count = int(options.hosts) if options.hosts.isdecimal() else options.hosts
    sharding.check_address(options.coordinator, count, options.host)
    if options.host == 0 and count > 1:
        say(f"waiting for the other hosts at {options.coordinator}", file=sys.stderr)
    sharding.initialize(options.coordinator, count, options.host)


def _events(wanted: bool) -> AbstractContextManager[Callable[[Path], None] | None]:
    """Opens what writes events for TensorBoard, or nothing."""
    if not wanted:
        return nullcontext()
    try:
        from murmurate.interop.tensorboard import Events
    except ModuleNotFoundError as error:
        raise UsageError(str(error)) from None
    return Events()


def _print_results(run: Run, folder: RunFolder) -> int:
    """Prints and draws a finished run; returns the exit status."""
    from murmurate.cli import summary
    from murmurate.runs.evaluate import evaluated, is_below

    summary.print_results(run, folder)
    say(f"picture: {summary.draw(folder)}")
    evaluation = evaluated(folder, trust=True)
    if not run.manifest["valid_pattern"]:
        say(f"No valid pattern was discovered. The run is kept in {folder.path}; try another --seed or more updates.")
        return NOTHING_VALID
    status = 0
    required = run.experiment.discovery.required_valid
    if is_below(evaluation, required):
        status = TOO_FEW_VALID
        share = f"{evaluation['valid']:.1%}"
        say(f"Valid patterns from {share} of the starts; discovery.required_valid asks for {required:.1%}.")
    say(f"animation: murmurate show {folder.path}")
    say(f"other starts: murmurate evaluate {folder.path} --seed 1 --out {folder.path}-evaluation")
    return status

"""`murmurate export`: a run's policies as an ONNX model, or its trajectories as waypoints."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Sequence
from pathlib import Path

from murmurate.cli import formations as formation_flags
from murmurate.cli.arguments import Parser
from murmurate.errors import RunError, UsageError, check_choice, escaped
from murmurate.terminal import say

__all__ = ["run"]

CASCADE = ("--policy", "--opset")
WAYPOINTS = ("--scale", "--period", "--episodes", "--robot-radius", "--robot-speed", "--pattern", "--target")


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser(
        "export", "RUN", "Takes a run to robots and other tools: policies as ONNX, trajectories as waypoints."
    )
    parser.add_argument("run", metavar="RUN", help="folder of a finished run; none: the package's weights", nargs="?")
    parser.add_argument("--onnx", action="store_true", help="write the cascade, or one policy, as an ONNX model")
    parser.add_argument(
        "--policy", type=int, metavar="INT", help="with --onnx: this policy alone (default: the cascade)"
    )
    parser.add_argument(
        "--opset", type=int, metavar="INT", help="with --onnx: version of ONNX's operators, 17 to 23 (default: 23)"
    )
    trajectories_help = "write the recorded episodes as waypoints in metres"
    parser.add_argument("--trajectories", metavar="csv|json", help=trajectories_help)
    parser.add_argument("--scale", type=float, metavar="METRES", help="metres of a world unit (default: 0.1)")
    parser.add_argument("--period", type=float, metavar="SECONDS", help="seconds of a step (default: 1)")
    parser.add_argument("--episodes", type=int, metavar="INT", help="how many of the recorded episodes (default: all)")
    parser.add_argument(
        "--robot-radius", type=float, metavar="METRES", help="refuse what robots this large cannot follow"
    )
    parser.add_argument("--robot-speed", type=float, metavar="M/S", help="refuse what robots this fast cannot follow")
    formation_flags.add_flags(parser, ", in fresh episodes, with --trajectories")
    parser.add_argument("--out", metavar="FILE", help="where to write (default: the run's name, .onnx, .csv or .json)")
    parser.add_argument("--trust", action="store_true", help="import the modules that RUN names, which executes them")
    options, _ = parser.parse(argv)
    given = {flag for flag in (*CASCADE, *WAYPOINTS) if getattr(options, flag[2:].replace("-", "_")) is not None}
    if options.onnx == (options.trajectories is not None):
        raise UsageError("give one of --onnx and --trajectories csv|json (see murmurate export --help)")
    for flag in sorted(given.intersection(WAYPOINTS if options.onnx else CASCADE)):
        raise UsageError(f"{flag} is for {'--trajectories' if options.onnx else '--onnx'}")
    if options.onnx:
        return _model(options)
    if options.run is None:
        raise UsageError("--trajectories needs a RUN that has recorded some")
    return _waypoints(options)


def _model(options: Namespace) -> int:
    folder: str | None = options.run
    path = _free(Path(options.out or f"{_name(folder) if folder else 'murmurate'}.onnx"))
    import murmurate
    from murmurate.runs import files
    from murmurate.runs.run import Run

    opened = Run.open(folder, options.trust) if folder else murmurate.pretrained()
    try:
        from murmurate.interop import onnx
    except ModuleNotFoundError as error:
        raise UsageError(str(error)) from None
    model = onnx.export(opened, options.policy, onnx.OPSET if options.opset is None else options.opset)
    difference = model.difference(opened)
    if not difference <= onnx.TOLERANCE:
        raise RunError(f"the model differs from the policy by {difference:.1e}: nothing was written")
    files.write_bytes(path, model.data)
    for name, shape in model.program.inputs.items():
        say(f"input: {name} {' x '.join(map(str, shape))}, float32")
    say(f"outputs: {', '.join(model.program.outputs)}")
    say(f"greatest difference over {onnx.CONFIGURATIONS:,} configurations: {difference:.1e}")
    say(f"model: {path}")
    return 0


def _waypoints(options: Namespace) -> int:
    from murmurate.interop.waypoints import FORMATS, Scale, Waypoints

    check_choice("--trajectories", options.trajectories, FORMATS)
    path = _free(Path(options.out or f"{_name(options.run)}.{options.trajectories}"))
    default = Scale()
    scale = Scale(
        metres=default.metres if options.scale is None else options.scale,
        seconds=default.seconds if options.period is None else options.period,
        robot_radius=options.robot_radius,
        robot_speed=options.robot_speed,
    )
    if formation_flags.is_told(options):
        from murmurate.runs.evaluate import EPISODES
        from murmurate.runs.run import Run

        run = formation_flags.told(Run.open(options.run, options.trust), options)
        trajectories = run.rollout(EPISODES if options.episodes is None else options.episodes)
        waypoints = Waypoints.from_trajectories(run.experiment, trajectories, scale, where=options.run)
        say(formation_flags.formed(run, trajectories))
    else:
        waypoints = Waypoints.from_run(options.run, scale, options.episodes, options.trust)
    waypoints.write(path, options.trajectories)
    for name, value in waypoints.about().items():
        say(f"{name.replace('_', ' ')}: {value}")
    episodes, left_out = len(waypoints.episodes), len(waypoints.left_out)
    note = f"; {left_out} that ended in contact or outside the world are left out" if left_out else ""
    say(f"episodes: {episodes}{note}")
    say(f"waypoints: {path}")
    return 0


def _name(folder: str) -> str:
    """Returns the name of a run folder for a file: a stranger's may hold what no name of a new file should."""
    return escaped(Path(folder).resolve().name)


def _free(path: Path) -> Path:
    """Makes sure that nothing is overwritten."""
    if os.path.lexists(path):
        raise RunError(f"{path} exists: choose another --out")
    if not path.parent.is_dir():
        raise RunError(f"{path}: there is no folder {path.parent}")
    return path

"""`murmurate show`: the figure and the animation of a run, or the patterns of several runs side by side."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from murmurate.cli.arguments import Parser
from murmurate.errors import UsageError

if TYPE_CHECKING:
    from murmurate.view import Record

__all__ = ["run"]


def run(argv: Sequence[str]) -> int:
    """Runs the verb; returns 0."""
    parser = Parser("show", "RUN...", "Draws the figure and the animation of a run; of several, their patterns.")
    parser.add_argument("runs", metavar="RUN", nargs="+", help="folder of a finished run")
    parser.add_argument("--episode", type=int, metavar="INT", help="which episode (default: a typical one)")
    parser.add_argument("--mp4", action="store_true", help="animate as mp4 (needs the video extra) instead of GIF")
    parser.add_argument("--out", metavar="DIR", help="where to write (default: RUN/figures)")
    options, _ = parser.parse(argv)
    folders = [Path(word) for word in options.runs]
    if len(folders) == 1:
        return _show(folders[0], Path(options.out or folders[0] / "figures"), options.episode, options.mp4)
    if options.out is None or options.episode is not None or options.mp4:
        raise UsageError("of several runs, only the patterns are drawn: give --out, and neither --episode nor --mp4")
    return _show_patterns(folders, Path(options.out))


def _show(folder: Path, out: Path, episode: int | None, mp4: bool) -> int:
    from murmurate import view

    record = _record(folder)
    animation = out / f"discovery.{'mp4' if mp4 else 'gif'}"
    figure = view.discovery_figure(record, episode)
    view.animate(record, animation, episode)
    view.save(figure, out / "discovery.png")
    print(f"picture: {out / 'discovery.png'}")
    print(f"animation: {animation}")
    return 0


def _show_patterns(folders: list[Path], out: Path) -> int:
    from murmurate import view

    records = [_record(folder) for folder in folders]
    view.save(view.patterns_figure(records, [record.name for record in records]), out / "patterns.png")
    print(f"picture: {out / 'patterns.png'}")
    return 0


def _record(folder: Path) -> Record:
    """Opens the record of a run whose files are as its manifest says."""
    from murmurate import view
    from murmurate.experiments import storage

    storage.verify(folder, storage.read_manifest(folder))
    return view.Record.open(folder)

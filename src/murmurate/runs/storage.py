"""Old names of `files` and `folder`, for modules that are not ported yet."""

from murmurate.runs.files import *  # noqa: F403
from murmurate.runs.files import append_rows as append_lines  # noqa: F401
from murmurate.runs.files import checksum, json  # noqa: F401
from murmurate.runs.files import truncate_rows as truncate_lines  # noqa: F401
from murmurate.runs.folder import EXPERIMENT, FORMAT, MANIFEST, RunFolder  # noqa: F401
from murmurate.runs.folder import FolderState as Found  # noqa: F401


def look(folder, resume=False):
    return RunFolder(folder).inspect(resume)


def claim(folder, resume=False):
    return RunFolder(folder).create(resume)


def read_manifest(folder):
    manifest = RunFolder(folder).manifest()
    text = "valid patterns discovered" if manifest["valid_pattern"] else "no valid pattern was discovered"
    return {"outcome": text, **manifest}


def verify(folder, manifest):
    RunFolder(folder).verify()

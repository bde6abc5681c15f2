"""Old name of `RunFolder.checkpoint`, for modules that are not ported yet."""

from murmurate.runs.folder import RunFolder


def load(folder, search):
    return RunFolder(folder).checkpoint(search)

"""Opens files in folders that may be a stranger's: no link is followed, nothing but regular files is read.

A folder from someone else may hold links to files elsewhere, pipes and devices that never end, or files of any size. So
files are opened without following a link and without waiting, and read up to a stated size. Nothing is written to a
file that is there: a new one, under a name that nobody can foresee, is moved into its place. What grows, metrics and
logs, is copied first where other files are hard links to it. Those are read like any others: backups are made of them.

Errors are `OSError`s with the name of the file, whose `strerror` is a reason in words; none repeats what a file holds.
"""

from __future__ import annotations

import contextlib
import errno
import os
import secrets
import stat
import time
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from filelock import lock_descriptor

__all__ = ["append", "check_inside", "create", "detach", "locked", "partial_files", "read", "read_end", "replace"]

# Not every system has all of these; without O_NOFOLLOW links are looked for first.
_NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)
_NO_WAIT = getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)

_JUNCTION = 0xA0000003
"""The tag of a folder of Windows that leads elsewhere as a link does."""

_NO_LOCKS = (errno.ENOLCK, errno.ENOTSUP, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL)
"""What a file system without locks says."""

_KEEPS_OPEN_FILES = os.name == "nt"
"""Whether a file that some process has open can be neither removed nor replaced, as on Windows."""

REPLACE_SECONDS = 2.0
"""Time that the readers of a file have for closing it, where an open file cannot be replaced."""


def read(path: str | os.PathLike[str], max_bytes: int, follow: bool = False) -> bytes:
    """Reads a regular file whole.

    Args:
        path: The file.
        max_bytes: Size of the largest file that is read.
        follow: Whether it may be a link: for files that the user names, never for those that a folder holds.

    Raises:
        OSError: It cannot be opened, is a link, is no regular file, or is too large.
    """
    descriptor = _open(path, os.O_RDONLY, follow)
    with _naming(path), open(descriptor, "rb") as file:
        _check_regular(descriptor)
        too_large = os.fstat(descriptor).st_size > max_bytes
        # The size alone is not believed: files of /proc have none, and a file may grow.
        data = b"" if too_large else file.read(max_bytes + 1)
        if too_large or len(data) > max_bytes:
            raise OSError(errno.EFBIG, f"it is larger than {max_bytes >> 10} KiB, the most that is read")
        return data


def read_end(path: str | os.PathLike[str], max_bytes: int) -> bytes:
    """Reads the last bytes of a regular file.

    Raises:
        OSError: It cannot be opened, is a link, or is no regular file.
    """
    descriptor = _open(path, os.O_RDONLY)
    with _naming(path), open(descriptor, "rb") as file:
        _check_regular(descriptor)
        file.seek(max(0, os.fstat(descriptor).st_size - max_bytes))
        return file.read(max_bytes)


def detach(path: str | os.PathLike[str], max_bytes: int) -> None:
    """Puts a copy into a file's place where the file has other names, hard links: writing to it changes none of those.

    Raises:
        OSError: It cannot be copied, or is too large.
    """
    with contextlib.suppress(FileNotFoundError):
        status = os.lstat(path)
        if stat.S_ISREG(status.st_mode) and status.st_nlink > 1:
            replace(path, read(path, max_bytes))


def append(path: str | os.PathLike[str]) -> BinaryIO:
    """Opens a regular file without a buffer, to write behind its end; creates it where there is none.

    Before writing, see `detach`.

    Raises:
        OSError: It cannot be opened, is a link, or is no regular file.
    """
    descriptor = _open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    try:
        with _naming(path):
            _check_regular(descriptor)
        return open(descriptor, "ab", buffering=0)
    except BaseException:
        os.close(descriptor)
        raise


@contextlib.contextmanager
def create(path: str | os.PathLike[str], data: bytes) -> Iterator[Path]:
    """Writes data to a new file beside a path, and removes it again at the end of the block, if it is still there.

    Yields:
        The new file, which is on disk.

    Raises:
        OSError: It cannot be written.
    """
    path = Path(path)
    partial = path.with_name(f".{path.name[:100]}.{secrets.token_hex(8)}.partial")
    try:
        with open(_open(partial, os.O_WRONLY | os.O_CREAT | os.O_EXCL), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        yield partial
    finally:
        with contextlib.suppress(OSError):
            partial.unlink()


def replace(path: str | os.PathLike[str], data: bytes) -> None:
    """Writes a file whole or not at all, in place of what has its name: a link is replaced, not followed.

    Raises:
        OSError: It cannot be written; what was there before still is.
    """
    path = Path(path)
    with create(path, data) as partial:
        _move(partial, path)
    with contextlib.suppress(OSError):  # the name is safe on disk too, where a folder can be synced
        descriptor = os.open(path.parent, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _move(source: Path, target: Path) -> None:
    until = time.monotonic() + REPLACE_SECONDS
    while True:
        try:
            return os.replace(source, target)
        except PermissionError:
            if not _KEEPS_OPEN_FILES or time.monotonic() > until:
                raise
        time.sleep(0.01)


@contextlib.contextmanager
def locked(path: str | os.PathLike[str], wait: bool = False) -> Iterator[None]:
    """Locks a file until the block or the process ends, however it ends; the file is there only in between.

    On a file system without locks nothing is locked.

    Args:
        path: The file, which holds nothing.
        wait: Whether to wait for another process that has locked it.

    Raises:
        BlockingIOError: Another process has locked it.
        OSError: It cannot be opened, is a link, or is no regular file.
    """
    path = Path(path)
    with contextlib.ExitStack() as stack:
        while True:
            file = stack.enter_context(append(path))
            try:
                if not lock_descriptor(file.fileno(), blocking=wait):
                    raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN), str(path))
            except OSError as error:
                if error.errno not in _NO_LOCKS:
                    raise
            # The process that held the lock may have removed the file in the meantime: then it locks nothing.
            with contextlib.suppress(OSError):
                if _KEEPS_OPEN_FILES or os.path.samestat(os.fstat(file.fileno()), path.stat()):
                    break
        try:
            yield
        finally:
            if _KEEPS_OPEN_FILES:  # a file that the next process has locked already is open, and so it stays
                stack.close()
            with contextlib.suppress(OSError):
                path.unlink()


def partial_files(folder: Path) -> list[Path]:
    """Returns the files that killed processes left in a folder unfinished."""
    return [path for path in folder.glob(".*.partial") if path.is_file() and not path.is_symlink()]


def check_inside(folder: str | os.PathLike[str], name: str) -> Path:
    """Returns the path of what a folder holds under a name, after checking that no part of the name is a link.

    Args:
        folder: The folder, which may be a link itself: the user names it.
        name: A relative path below it.

    Raises:
        OSError: A part of the name is a link, or leads out of the folder.
    """
    path = Path(folder)
    for part in Path(name).parts:
        path = path / part
        if part == ".." or os.path.isabs(part) or Path(part).drive:
            raise OSError(errno.EPERM, "it is outside the folder", str(path))
        if _is_link(path):
            raise OSError(errno.ELOOP, f"{path.name} is a link, and links in a folder are not followed", str(path))
    return path


def _open(path: str | os.PathLike[str], flags: int, follow: bool = False) -> int:
    if not follow and _is_link(path) and not flags & os.O_EXCL:
        raise OSError(errno.ELOOP, "it is a link, and links in a folder are not followed", str(path))
    return os.open(path, flags | _NO_WAIT | (0 if follow else _NO_FOLLOW), 0o666)


@contextlib.contextmanager
def _naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Adds the name of a file to an error of its descriptor, which has none."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def _is_link(path: str | os.PathLike[str]) -> bool:
    try:
        status = os.lstat(path)
    except (OSError, ValueError):
        return False
    return stat.S_ISLNK(status.st_mode) or getattr(status, "st_reparse_tag", 0) == _JUNCTION


def _check_regular(descriptor: int) -> None:
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISDIR(mode):
        raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
    if not stat.S_ISREG(mode):
        raise OSError(errno.EINVAL, "it is no regular file")

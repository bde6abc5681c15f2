"""Does what needs no training without what only POSIX has: `test_portability.py` runs it in a process of its own."""

from __future__ import annotations

# Python's library and other packages take what the system has when they are loaded: those that do come first.
import asyncio  # noqa: F401
import importlib
import os
import pkgutil
import signal
import sys
import warnings
from pathlib import Path

import filelock  # noqa: F401
import jax
import matplotlib.backends.backend_agg  # noqa: F401
import pytest
import rich.live  # noqa: F401
import safetensors.numpy  # noqa: F401
import scipy.optimize  # noqa: F401

MODULES = "fcntl grp pty pwd readline resource syslog termios tty"
NAMES = {
    os: (
        "O_CLOEXEC O_DIRECTORY O_NOFOLLOW O_NONBLOCK O_SYNC chown chroot fchown fork forkpty getegid geteuid getgid "
        "getloadavg getpgid getuid initgroups killpg lchown mkfifo mknod nice openpty posix_spawn register_at_fork "
        "sched_getaffinity sched_setaffinity setgid setsid setuid statvfs sysconf uname wait3 wait4"
    ),
    signal: "SIGALRM SIGCHLD SIGHUP SIGKILL SIGPIPE SIGQUIT SIGUSR1 SIGUSR2 alarm pause pthread_kill setitimer",
}


def main(run: str, out: str) -> None:
    """Reads a finished run, and copies it."""
    for name in MODULES.split():
        sys.modules[name] = None  # type: ignore[assignment]
    for module, names in NAMES.items():
        for name in names.split():
            if hasattr(module, name):
                delattr(module, name)
    # This process has the flag for it: who opens text without naming an encoding is warned.
    warnings.filterwarnings("error", category=EncodingWarning, module="murmurate")

    import murmurate

    for module in pkgutil.walk_packages(murmurate.__path__, "murmurate."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

    from murmurate.cli.main import main
    from murmurate.errors import RunError
    from murmurate.runs.execute import count_cores
    from murmurate.runs.folder import RunFolder

    for arguments in ["--help"], ["sweep", "--help"], ["table", run], ["experiments"]:
        assert main(arguments) == 0, arguments
    folder = RunFolder(run)
    assert folder.inspect(resume=True) == "finished"
    manifest, config = folder.verify(), folder.experiment()
    assert folder.trajectories(config).positions.shape[2] == config.world.robots == 3
    assert folder.metrics()
    assert folder.evaluation()["episodes"] == 200
    copy = folder.copy_to(out)
    assert copy.manifest()["checksums"].keys() <= manifest["checksums"].keys()
    with copy.lock(), pytest.raises(RunError, match="another process trains this run"), RunFolder(out).lock():
        pass
    assert not list(Path(out).glob(".*"))
    assert count_cores() == os.cpu_count()
    assert not jax._src.xla_bridge._backends, "nothing here computes"


if __name__ == "__main__":
    main(*sys.argv[1:])

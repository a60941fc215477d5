"""Launcher of `drive-profiles` without what Windows lacks: `python -m tests.drive_profiles.not_posix ARGUMENTS`.

Names and modules are taken away before anything of ours is imported. What `os.open` opens without `O_BINARY` is a text file: each
line end written through `os.write` becomes CR LF. No folder is opened. Standard output has code page 1252.
"""

import asyncio  # noqa: F401 - as for all that is imported unused: others' own branches for POSIX need what is taken away
import multiprocessing.connection  # noqa: F401
import os
import select
import shutil  # noqa: F401
import signal
import socket
import subprocess  # noqa: F401
import sys

import numpy as np  # noqa: F401

MODULES = ("fcntl", "termios", "tty", "pty", "resource", "grp", "pwd", "syslog", "_posixshmem")
SIGNALS = ("SIGHUP", "SIGKILL", "SIGALRM", "SIGUSR1", "SIGUSR2", "SIGPIPE", "SIGQUIT", "SIGCHLD", "SIGTSTP", "SIGSTOP", "SIGCONT")
NAMES = {
    signal: (*SIGNALS, "pthread_sigmask", "sigwait", "setitimer", "alarm", "pause"),
    socket: ("AF_UNIX", "AF_CAN", "PF_CAN", "CAN_RAW", "SOCK_SEQPACKET", "MSG_DONTWAIT", "SO_PEERCRED"),
    select: ("poll", "epoll"),
    os: (
        *("O_NONBLOCK", "O_NOCTTY", "O_CLOEXEC", "O_DIRECTORY", "O_NOFOLLOW", "O_SYNC", "O_DSYNC"),
        *("fork", "getuid", "geteuid", "getgid", "getegid", "getppid", "uname", "mkfifo", "fchmod", "fchown", "chown", "statvfs"),
        *("sched_getaffinity", "sched_setaffinity", "sched_yield", "sched_setscheduler", "setsid", "killpg", "nice"),
        *("pread", "pwrite", "writev", "sysconf", "fdatasync", "sync", "openpty", "memfd_create", "wait", "wait4", "WNOHANG"),
    ),
}
O_BINARY = 0x8000  # as Windows has it; here it asks for large files, which are the rule


def take_away() -> None:
    for name in MODULES:
        sys.modules[name] = None  # type: ignore[assignment]  # its import raises ModuleNotFoundError
    for module, names in NAMES.items():
        for name in names:
            if hasattr(module, name):
                delattr(module, name)
    os.O_BINARY = O_BINARY  # type: ignore[attr-defined]
    texts = set()
    open_file, write, close = os.open, os.write, os.close

    def opened(path, flags, mode=0o777, *, dir_fd=None):
        if os.path.isdir(path):
            raise PermissionError(13, "Permission denied", str(path))
        file = open_file(path, flags, mode, dir_fd=dir_fd)
        if not flags & O_BINARY:
            texts.add(file)
        return file

    def written(file, data):
        return len(data) if file in texts and write(file, data.replace(b"\n", b"\r\n")) else write(file, data)

    def closed(file):
        texts.discard(file)
        close(file)

    os.open, os.write, os.close = opened, written, closed


if __name__ == "__main__":
    take_away()
    sys.stdout.reconfigure(encoding="cp1252")
    sys.stderr.reconfigure(encoding="cp1252")
    from drive_profiles.__main__ import main

    main()

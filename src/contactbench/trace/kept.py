"""Compiled code kept on disk between processes, in a folder that no other user can write to."""

from __future__ import annotations

import hashlib
import os
import stat
from contextlib import suppress
from functools import cache
from pathlib import Path

from contactbench.files import replacing

#: the environment variable that names the folder; without it programs are kept in the user's cache folder
VARIABLE = "CONTACTBENCH_CACHE"
#: length of a digest in bytes
DIGEST = hashlib.sha256().digest_size


def is_private(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user and no other user may write to it."""
    if not hasattr(os, "getuid"):  # Windows: the cache folder is the user's own
        return True
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


@cache
def folder(kind: str) -> Path | None:
    """Return the folder of one kind of kept code; None if it is not writable, or others may write there."""
    from platformdirs import user_cache_path

    chosen = os.environ.get(VARIABLE)
    path = (Path(chosen) if chosen else user_cache_path("contactbench")) / kind
    with suppress(OSError):
        for each in (path.parent, path):
            each.mkdir(mode=0o700, parents=True, exist_ok=True)
        if is_private(path.parent.stat()) and is_private(path.stat()) and os.access(path, os.W_OK):
            return path
    return None


def kept_file(name: str) -> Path | None:
    """Return where a program of a name is kept, if any are."""
    programs = folder("programs")
    return programs and programs / name


def seal(path: Path, content: bytes) -> bytes:
    """Return the digest at the head of a file; it covers the name, which stands for program, versions and processor."""
    return hashlib.sha256(path.name.encode() + b"\n" + content).digest()


def read_kept(path: Path | None) -> bytes | None:
    """Return the kept code; None if there is no file, or it is damaged, renamed, or writable by other users."""
    if path is None:
        return None
    with suppress(OSError), open(path, "rb", opener=without_waiting) as file:
        status = os.fstat(file.fileno())
        if stat.S_ISREG(status.st_mode) and is_private(status):
            head, content = file.read(DIGEST), file.read()
            if head == seal(path, content):
                return content
    return None


def without_waiting(path: str, flags: int) -> int:
    """Open a file; for another end of a pipe nobody waits."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def write_kept(path: Path | None, content: bytes) -> None:
    if path is None or (path.exists() and not path.is_file()):
        return
    with suppress(OSError), replacing(path, sync=False, mode="wb") as file:
        file.write(seal(path, content) + content)

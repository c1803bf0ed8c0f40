"""Compiled code kept on disk between processes, in a folder that no other user can write to."""

from __future__ import annotations

import hashlib
import os
import tempfile
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
def folder() -> Path:
    """Return the folder of kept programs, or a temporary one if it is not writable or others may write to it."""
    from platformdirs import user_cache_path

    chosen = os.environ.get(VARIABLE)
    path = (Path(chosen) if chosen else user_cache_path("contactbench")) / "programs"
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.mkdir(mode=0o700, exist_ok=True)
        if is_private(path.stat()):
            with tempfile.TemporaryFile(dir=path):
                return path
    path = Path(tempfile.mkdtemp(prefix="contactbench-")) / "programs"
    path.mkdir()
    return path


def seal(path: Path, content: bytes) -> bytes:
    """Return the digest at the head of a file; it covers the name, which stands for program, versions and processor."""
    return hashlib.sha256(path.name.encode() + b"\n" + content).digest()


def read_kept(path: Path) -> bytes | None:
    """Return the kept code; None if the file is missing, damaged, renamed, or writable by other users."""
    with suppress(OSError), path.open("rb") as file:
        head, content = file.read(DIGEST), file.read()
        if is_private(os.fstat(file.fileno())) and head == seal(path, content):
            return content
    return None


def write_kept(path: Path, content: bytes) -> None:
    with suppress(OSError), replacing(path, sync=False, mode="wb") as file:
        file.write(seal(path, content) + content)

"""Compiled code kept on disk from one process to the next, where nobody else can have put it."""

from __future__ import annotations

import hashlib
import os
import tempfile
from contextlib import suppress
from functools import cache
from pathlib import Path

from contactbench.files import replacing

#: folder for compiled programs; by default the user's cache folder
VARIABLE = "CONTACTBENCH_CACHE"
#: bytes of a digest
DIGEST = hashlib.sha256().digest_size


def is_private(status: os.stat_result) -> bool:
    """Return whether a file or folder belongs to this user, and nobody else may write to it."""
    if not hasattr(os, "getuid"):  # Windows: the cache folder is the user's own
        return True
    return status.st_uid == os.getuid() and not status.st_mode & 0o022


@cache
def folder() -> Path:
    """Return where programs are kept: a new folder of this process where that is not writable, or others may write."""
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
    """Return the head of a file, which fits no other name: a name says the program, the versions and the processor."""
    return hashlib.sha256(path.name.encode() + b"\n" + content).digest()


def read_kept(path: Path) -> bytes | None:
    """Return what was kept; None where a file is missing, damaged, that of another name, or others may write to it."""
    with suppress(OSError), path.open("rb") as file:
        head, content = file.read(DIGEST), file.read()
        if is_private(os.fstat(file.fileno())) and head == seal(path, content):
            return content
    return None


def write_kept(path: Path, content: bytes) -> None:
    with suppress(OSError), replacing(path, sync=False, mode="wb") as file:
        file.write(seal(path, content) + content)

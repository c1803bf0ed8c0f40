"""Recorded programs compiled by numba (LLVM), and kept: a program is compiled once, not once per process.

numba is imported when the first program is compiled.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import tempfile
from functools import cache
from pathlib import Path
from types import ModuleType

from contactbench.numbers.recording import PREAMBLE

#: folder for generated sources and compiled programs; by default the user's cache folder
VARIABLE = "CONTACTBENCH_CACHE"
#: products and sums may be fused, nothing else of IEEE arithmetic is given up; divisions by zero give inf
HEADER = f"""from numba import njit

{PREAMBLE}
compiled = {{"fastmath": {{"contract"}}, "error_model": "numpy", "nogil": True, "cache": True}}

"""
#: signatures of the functions of a program, which are compiled when its module is imported
SIGNATURES = {
    "setup": "void(float64[::1], float64[:, ::1], float64[::1], int64[::1], float64[:, ::1])",
    "run": "int64(float64[::1], float64[:, ::1], int64[::1], int64[::1], float64[:, ::1])",
}
#: the date of every generated file: one that is written anew is the same to numba's cache
DATE = 1_000_000_000


@cache
def folder() -> Path:
    """Where programs are kept; a folder of this process alone where that cannot be written to."""
    from platformdirs import user_cache_path

    chosen = os.environ.get(VARIABLE)
    path = Path(chosen) if chosen else user_cache_path("contactbench")
    try:
        path = path / "programs"
        path.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=path):
            return path
    except OSError:
        return Path(tempfile.mkdtemp(prefix="contactbench-"))


_modules: dict[str, ModuleType] = {}


def compiled(text: str) -> ModuleType:
    """The module of a program's source, its functions compiled for their `SIGNATURES`.

    Raises `ImportError` where numba is not installed.
    """
    if text not in _modules:
        for name, signature in SIGNATURES.items():
            text_of = f"def {name}("
            decorated = f'@njit("{signature}", **compiled)\n{text_of}'
            source = (source if name != "setup" else HEADER + text).replace(text_of, decorated)
        _modules[text] = imported(source)
    return _modules[text]


def imported(source: str) -> ModuleType:
    """A module from a file of the cache folder, which is written unless it is there."""
    name = f"contactbench_program_{hashlib.sha256(source.encode()).hexdigest()[:32]}"
    path = folder() / f"{name}.py"
    if not path.exists() or path.read_text() != source:
        with tempfile.NamedTemporaryFile("w", dir=folder(), suffix=".tmp", delete=False) as file:
            file.write(source)
        os.utime(file.name, (DATE, DATE))
        os.replace(file.name, path)
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module

"""Private interfaces of the peers' libraries: the symbols of CVODE, the C interface of CyRK.

A C signature is written as a word, a letter for the result and one for every argument; ctypes and numba read the
same word.  Imported where a peer is first run, and only then: importing it loads numba.
"""

from __future__ import annotations

import ctypes
import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite.binding
import numba
from numba import njit, types
from numba.core.ccallback import CFunc
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps
from numba.core.sigutils import normalize_signature

from contactbench.peers import compiled
from contactbench.peers.compiled import ORIGIN
from contactbench.trace.form import digest
from contactbench.trace.kept import folder, kept_file, read_kept, write_kept

if TYPE_CHECKING:
    from numba.core.codegen import CPUCodegen
    from numba.core.cpu import CPUContext
    from numba.core.typing import Signature

#: v void, p pointer, a array of doubles, d double, b bool, i int, l long, q 64-bit int, z size_t
#: letter → types of ctypes and numba
LETTERS: dict[str, tuple[type | None, types.Type]] = {
    "v": (None, types.none),
    "p": (ctypes.c_void_p, types.intp),
    "a": (ctypes.c_void_p, types.CPointer(types.float64)),
    "d": (ctypes.c_double, types.float64),
    "b": (ctypes.c_bool, types.boolean),
    "i": (ctypes.c_int, types.int32),
    "l": (ctypes.c_long, types.long_),
    "q": (ctypes.c_int64, types.int64),
    "z": (ctypes.c_size_t, types.uintp),
}

#: the compiled code here depends on all of it
SOURCES = digest(
    *(path.read_bytes() for path in (*sorted(Path(__file__).parent.glob("*.py")), Path(compiled.__file__)))
)


class Kept:
    """The cache of one function, in a private folder; numba's own fails for ever on a damaged file."""

    cache_path = property(lambda self: str(folder("programs") or ""))

    def __init__(self, function: Callable[..., Any]) -> None:
        self.key = digest(function.__module__, function.__qualname__, SOURCES)

    def path(self, signature: Signature, codegen: CPUCodegen) -> Path | None:
        key = digest(self.key, str(signature), codegen.magic_tuple(), numba.__version__, sys.version)
        return kept_file(f"{key}.program")

    def load_overload(self, signature: Signature, context: CPUContext) -> Any:
        context.refresh()
        with suppress(Exception):  # whatever is wrong with the file
            if (content := read_kept(self.path(signature, context.codegen()))) is not None:
                return CompileResult._rebuild(context, *pickle.loads(content))
        return None

    def save_overload(self, signature: Signature, compiled: Any) -> None:
        if not (compiled.lifted or compiled.library.has_dynamic_globals):
            write_kept(self.path(signature, compiled.codegen), dumps(compiled._reduce()))


def kept[**P, R](function: Callable[P, R]) -> Callable[P, R]:
    """Compile as numba's `njit` does, and keep the program."""
    made: Any = njit(nogil=True)(function)
    made._cache = Kept(function)
    found: Callable[P, R] = made
    return found


def kept_c(signature: Signature) -> Callable[[Callable[..., Any]], Any]:
    """Compile as numba's `cfunc` does, and keep the program."""

    def compile_c(function: Callable[..., Any]) -> Any:
        made: Any = CFunc(function, normalize_signature(signature), {}, {})
        made._cache = Kept(function)
        made.compile()
        return made

    return compile_c


def external(name: str, address: int | None, word: str) -> Callable[..., Any]:
    llvmlite.binding.add_symbol(name, address)
    result, *arguments = (LETTERS[letter][1] for letter in word)
    return types.ExternalFunction(name, result(*arguments))


# -- packed states without the time; number by number: numba takes seconds to compile the first assignment of a slice
@kept
def split(state, y, data, clock):  # type: ignore[no-untyped-def]
    """Put a packed state into a solver's vector, its time, where it has one (clock ≥ 0), into `data`."""
    for i in range(len(y)):
        y[i] = state[i + (0 <= clock <= i)]
    if clock >= 0:
        data[ORIGIN] = state[clock]


@kept
def join(y, t, data, clock, state):  # type: ignore[no-untyped-def]
    """Put together the packed state of a solver's vector, t after it began."""
    for i in range(len(state) - (clock >= 0)):
        state[i + (0 <= clock <= i)] = y[i]
    if clock >= 0:
        state[clock] = data[ORIGIN] + t

"""Functions that numba compiles, and keeps; it takes as long to import as all else, and is loaded when one is made."""

from __future__ import annotations

import pickle
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from contactbench.trace.form import digest
from contactbench.trace.kept import folder, read_kept, write_kept

if TYPE_CHECKING:
    from numba.core.codegen import CPUCodegen
    from numba.core.cpu import CPUContext
    from numba.core.typing import Signature

#: a function that numba makes or compiles
Compiled = Callable[..., Any]


class Kept:
    """The cache of one function, in the place of numba's own, which fails for good on a file that is damaged.

    numba's form of a compiled function is a pickle: `read_kept` gives only what this user has written.
    """

    cache_path = property(lambda self: str(folder()))

    def __init__(self, key: str) -> None:
        self.key = key

    def path(self, signature: Signature, codegen: CPUCodegen) -> Path:
        from numba import __version__

        key = digest(self.key, str(signature), codegen.magic_tuple(), __version__, sys.version)
        return folder() / f"{key}.program"

    def load_overload(self, signature: Signature, context: CPUContext) -> Any:
        from numba.core.compiler import CompileResult

        context.refresh()
        with suppress(Exception):  # whatever is wrong with the file
            if (content := read_kept(self.path(signature, context.codegen()))) is not None:
                return CompileResult._rebuild(context, *pickle.loads(content))
        return None

    def save_overload(self, signature: Signature, compiled: Any) -> None:
        from numba.core.serialize import dumps

        if not (compiled.lifted or compiled.library.has_dynamic_globals):
            write_kept(self.path(signature, compiled.codegen), dumps(compiled._reduce()))


def keep(function: Compiled, *key: str, **options: Any) -> Any:
    """Compile as numba's `njit` with a cache; key : what the function depends on besides its name."""
    from numba import njit

    made = njit(**options)(function)
    made._cache = Kept(digest(function.__module__, function.__qualname__, *key))
    return made


def entry(function: Any, *arguments: object) -> Compiled:
    """Return what `keep` compiles for such arguments: at a call numba looks for it for a third of a microsecond."""
    from numba import typeof

    kinds = tuple(map(typeof, arguments))
    function.compile(kinds)
    made: Compiled = function.overloads[kinds].entry_point
    return made


def keep_c(function: Compiled, signature: Signature, *key: str) -> Any:
    """Compile as numba's `cfunc` with a cache."""
    from numba.core.ccallback import CFunc
    from numba.core.sigutils import normalize_signature

    made: Any = CFunc(function, normalize_signature(signature), {}, {})
    made._cache = Kept(digest(function.__module__, function.__qualname__, *key))
    made.compile()
    return made

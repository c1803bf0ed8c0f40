"""What kind of program an engine is, so that compiled solvers are compared with compiled ones."""

from __future__ import annotations

#: engine → "compiled" (solver and right-hand side are machine code) or "callbacks" (the right-hand side,
#: or the solver too, is Python)
ENGINES = {
    "numba": "compiled",
    "jax": "compiled",
    "llvm": "compiled",
    "c": "compiled",
    "c++": "compiled",
    "python": "callbacks",
    "c+python": "callbacks",
}
CALLBACKS = tuple(engine for engine, kind in ENGINES.items() if kind == "callbacks")

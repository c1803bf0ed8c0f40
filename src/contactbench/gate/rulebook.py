"""A process that prints the rules of the revision on PYTHONPATH, as JSON: run by path, for judge.py.

"rules" has the constants of the gate and the rule of every column, "code" a digest of what each module does with them.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import inspect
import json
from importlib import import_module
from types import ModuleType

MODULES = (
    "gate.accuracy", "gate.committed", "gate.rules", "gate.speed", "gate.speed_worker", "gate.workload",
    "results.round_off", "results.schema",
)  # fmt: skip


def code(module: ModuleType) -> str:
    """A digest of the functions and classes of a module, without comments and docstrings."""
    tree = ast.parse(inspect.getsource(module))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node) is not None:
            node.body[:1] = []
    kept = [ast.dump(node) for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)]
    return hashlib.sha256("".join(kept).encode()).hexdigest()[:8]


def main() -> None:
    from contactbench.results.schema import TABLES

    rules, codes = {}, {}
    for name in MODULES:
        with contextlib.suppress(ModuleNotFoundError):  # of an older or newer revision
            module = import_module(f"contactbench.{name}")
            codes[name] = code(module)
            for constant, value in vars(module).items():
                if constant.isupper() and isinstance(value, int | float | str | tuple):
                    rules[f"{name}.{constant}"] = str(value)
    for table in TABLES.values():
        rules |= {f"{table.name}.{column}": rule.name for column, rule in table.rules.items()}
    print(json.dumps({"rules": rules, "code": codes}))


if __name__ == "__main__":
    main()

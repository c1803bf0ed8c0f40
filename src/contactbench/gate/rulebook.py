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

MODULES = (
    "gate.accuracy", "gate.committed", "gate.rules", "gate.speed", "gate.speed_worker", "gate.workload",
    "results.round_off", "results.schema",
)  # fmt: skip


def read(source: str) -> tuple[dict[str, str], str]:
    """The constants of a module as written, and a digest of its functions and classes without their docstrings."""
    constants, definitions = {}, ""
    tree = ast.parse(source)
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.ClassDef) and ast.get_docstring(node) is not None:
            node.body[:1] = []
    for node in tree.body:
        match node:
            case ast.FunctionDef() | ast.ClassDef():
                definitions += ast.dump(node)
            case ast.Assign(targets=[ast.Name(name)]) | ast.AnnAssign(target=ast.Name(name)):
                constants[name] = ast.unparse(node.value) if node.value else ""
    return constants, hashlib.sha256(definitions.encode()).hexdigest()[:8]


def main() -> None:
    from contactbench.results.schema import TABLES

    rules, codes = dict[str, str](), dict[str, str]()
    for name in MODULES:
        with contextlib.suppress(ModuleNotFoundError):  # of an older or newer revision
            constants, codes[name] = read(inspect.getsource(import_module(f"contactbench.{name}")))
            rules |= {f"{name}.{constant}": value for constant, value in constants.items()}
    for table in TABLES.values():
        rules |= {f"{table.name}.{column}": rule.name for column, rule in table.rules.items()}
    print(json.dumps({"rules": rules, "code": codes}))


if __name__ == "__main__":
    main()

"""Plant slips in a copy of the sources, one at a time, and see which of them the quick tests let pass.

python tests/mutation.py FOLDER map [pytest's arguments] : which test runs which line, and how long it takes
python tests/mutation.py FOLDER run COUNT [SEED] : judges mutants drawn at random, and goes on where it was
"""

import ast
import compileall
import importlib
import itertools
import json
import os
import py_compile
import random
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from multiprocessing import get_context
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
SOURCE = "src/contactbench/"
#: private interfaces of other libraries, which end the process where they are called wrongly
LEFT_OUT = ("peers/abi/",)
#: seconds of tests that judge a mutant, as they were measured, and how long they may take
ENOUGH, MOST = 15.0, 75
PAIRS = "Lt LtE, Gt GtE, Eq NotEq, Is IsNot, In NotIn, Add Sub, Mult Div, BitOr BitAnd, And Or"
OTHER = {a: b for pair in PAIRS.split(", ") for a, b in (pair.split(), reversed(pair.split()))}
OTHER |= {"FloorDiv": "Mult", "Mod": "FloorDiv", "Pow": "Mult"}
CALLED = {"min": "max", "max": "min", "any": "all", "all": "any", "minimum": "maximum", "maximum": "minimum"}


def slips(node):
    """Yield what may stand by mistake in the place of an expression or a return."""
    match node:
        case ast.Compare(left, [op, *rest], right) if type(op).__name__ in OTHER:
            yield ast.Compare(left, [getattr(ast, OTHER[type(op).__name__])(), *rest], right)
        case ast.BinOp(left, op, right) if type(op).__name__ in OTHER:
            yield ast.BinOp(left, getattr(ast, OTHER[type(op).__name__])(), right)
        case ast.BoolOp(op, values):
            yield ast.BoolOp(getattr(ast, OTHER[type(op).__name__])(), values)
        case ast.UnaryOp(ast.Not() | ast.USub(), operand):
            yield operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() | float() as value):
            yield from (ast.Constant(value + 1), ast.Constant(value - 1))
        case ast.Return(ast.expr() as value) if ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))
        case ast.Call(ast.Name(name), given, named) if name in CALLED:
            yield ast.Call(ast.Name(CALLED[name]), given, named)
        case ast.Call(function, [one, two, *rest], named) if not isinstance(one, ast.Starred):
            yield ast.Call(function, [two, one, *rest], named)


def nodes(tree):
    """Yield the nodes of a tree but those of annotations, imports, messages and `strict=`."""
    yield tree
    for name, field in ast.iter_fields(tree):
        for child in (field if isinstance(field, list) else [field]) * (
            name not in ("annotation", "returns")
        ):
            message = isinstance(child, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom)
            if isinstance(child, ast.AST) and not message and getattr(child, "arg", "") != "strict":
                yield from nodes(child)


def mutants():
    """Yield file, line, text before and after, and the bytes between which it stands."""
    for path in sorted((ROOT / SOURCE).rglob("*.py")):
        if not (name := path.relative_to(ROOT / SOURCE).as_posix()).startswith(LEFT_OUT):
            lines = path.read_bytes().splitlines(keepends=True)
            for node in nodes(ast.parse(b"".join(lines))):
                for new in slips(node):
                    ends = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
                    first, last = (sum(map(len, lines[: line - 1])) + column for line, column in ends)
                    after = ast.unparse(new) if isinstance(new, ast.stmt) else f"({ast.unparse(new)})"
                    yield name, node.lineno, ast.unparse(node), after, first, last


class Map:
    """A plug-in of pytest: which test runs which line, and how long it takes."""

    def __init__(self, path):
        self.path, self.test, self.lines, self.seconds = path, "", defaultdict(set), defaultdict(float)
        monitor, this = sys.monitoring, sys.monitoring.COVERAGE_ID
        monitor.use_tool_id(this, "mutation")
        monitor.register_callback(this, monitor.events.LINE, self.run)
        monitor.set_events(this, monitor.events.LINE)

    def run(self, code, line):
        file = code.co_filename.removeprefix(f"{ROOT}/{SOURCE}")
        if file != code.co_filename and self.test:
            self.lines[f"{file}:{line}"].add(self.test)
        return sys.monitoring.DISABLE

    def pytest_runtest_logstart(self, nodeid):
        self.test = nodeid
        sys.monitoring.restart_events()

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] += 1e9 if report.outcome == "failed" else report.duration

    def pytest_sessionfinish(self):
        known = json.loads(self.path.read_text()) if self.path.exists() else {"lines": {}, "seconds": {}}
        for line, tests in self.lines.items():
            known["lines"][line] = sorted({*known["lines"].get(line, []), *tests})
        self.path.write_text(
            json.dumps({"lines": known["lines"], "seconds": known["seconds"] | self.seconds})
        )


def judges(known, name, line):
    """Return the tests that run a line, those of its package first, quickest first; of two files, then of all.

    Where there are none, as where a line is run at import, those of the package.
    """
    package, seconds = f"tests/{name.split('/')[0].removesuffix('.py')}/", known["seconds"]
    tests = known["lines"].get(f"{name}:{line}") or [test for test in seconds if test.startswith(package)]
    tests = sorted(tests, key=lambda test: (not test.startswith(package), seconds[test]))
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    for some in ([*files[:2]], files[2:]):
        given = [test for test in tests if test.partition("::")[0] in some]
        spent = itertools.accumulate(seconds[test] for test in given)
        yield [test for test, total in zip(given, spent, strict=True) if total < ENOUGH]


def killer(tree, tests):
    """Return what fails of some tests in a copy of the project, or nothing."""
    with tempfile.TemporaryDirectory() as cache:  # what a mutant compiles is no other's
        process = get_context("fork").Process(target=work, args=(tree, cache, tests))
        process.start()
        process.join(MOST)
        process.kill()
        process.join()
    log = (Path(tree) / "log").read_text(errors="replace").splitlines()
    failed = (line for line in log if line.startswith(("FAILED", "ERROR")))
    return next(failed, f"exit {process.exitcode}" if process.exitcode else "")


def work(tree, cache, tests):
    os.chdir(tree)
    sys.path[:0], os.environ["PYTHONPATH"] = [f"{tree}/src", str(tree)], f"{tree}/src:{tree}"
    os.environ["CONTACTBENCH_CACHE"] = cache
    os.dup2(os.open("log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC), 1)
    os._exit(pytest.main(["-xq", "-p", "no:cacheprovider", "--tb=no", *tests]))


def judge(folder, count, seed=40):
    known, path = json.loads((folder / "map.json").read_text()), folder / "mutants.jsonl"
    done = len(path.read_text().splitlines()) if path.exists() else 0
    files = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=True).stdout
    for library in ("jax", "diffrax", "numba", "pandas", "mpmath", "scipy.integrate", "matplotlib.pyplot"):
        importlib.import_module(library)  # once for all mutants
    with tempfile.TemporaryDirectory() as tree:
        for name in files.splitlines():
            (Path(tree) / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, Path(tree) / name)
        compileall.compile_dir(tree, quiet=1, invalidation_mode=py_compile.PycInvalidationMode.CHECKED_HASH)
        for name, line, before, after, first, last in random.Random(int(seed)).sample(
            [*mutants()], int(count)
        )[done:]:
            place, killed = Path(tree) / SOURCE / name, ""
            text = place.read_bytes()
            place.write_bytes(text[:first] + after.encode() + text[last:])
            for tests in filter(None, judges(known, name, line)):
                if killed := killer(tree, tests):
                    break
            place.write_bytes(text)
            with path.open("a") as file:
                print(json.dumps([name, line, before, after, killed]), file=file)


if __name__ == "__main__":
    where, what, *more = sys.argv[1:]
    if what == "map":
        pytest.main(more, plugins=[Map(Path(where) / "map.json")])
    else:
        judge(Path(where), *more)

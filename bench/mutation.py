"""Plant slips in a copy of the sources, one at a time, and see which of them the quick tests let pass.

python bench/mutation.py FOLDER map [pytest's arguments] : which test runs which line, and how long it takes
python bench/mutation.py FOLDER run COUNT [SEED] : judges mutants drawn at random, and goes on where it was
"""

import ast
import itertools
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from pathlib import Path

import pytest

ROOT, SOURCE = Path(__file__).parents[1], "src/contactbench/"
#: private interfaces of other libraries, which end the process where they are called wrongly
LEFT_OUT = ("peers/abi/",)
#: seconds of tests that judge a mutant, as they were measured, and how long they may take
ENOUGH, MOST = 15.0, 75
PAIRS = "Lt LtE, Gt GtE, Eq NotEq, Is IsNot, In NotIn, Add Sub, Mult Div, BitOr BitAnd, And Or"
OTHER = {a: b for pair in PAIRS.split(", ") for a, b in (pair.split(), reversed(pair.split()))}
OTHER |= {"FloorDiv": "Mult", "Mod": "FloorDiv", "Pow": "Mult"}
CALLED = {"min": "max", "max": "min", "any": "all", "all": "any"}


def slips(node):
    """Yield what may stand by mistake in the place of an expression or a return."""
    op = node.ops[0] if isinstance(node, ast.Compare) else getattr(node, "op", None)
    other = getattr(ast, OTHER.get(type(op).__name__, "Load"))()
    match node:
        case ast.Compare() if type(op).__name__ in OTHER:
            yield ast.Compare(node.left, [other, *node.ops[1:]], node.comparators)
        case ast.BinOp() if type(op).__name__ in OTHER:
            yield ast.BinOp(node.left, other, node.right)
        case ast.BoolOp():
            yield ast.BoolOp(other, node.values)
        case ast.UnaryOp(ast.Not() | ast.USub()):
            yield node.operand
        case ast.Constant(bool() as value):
            yield ast.Constant(not value)
        case ast.Constant(int() | float() as value):
            yield from (ast.Constant(value + 1), ast.Constant(value - 1))
        case ast.Return(ast.expr() as value) if ast.unparse(value) != "None":
            yield ast.Return(ast.Constant(None))
        case ast.Call(ast.Name(name)) if name in CALLED:
            yield ast.Call(ast.Name(CALLED[name]), node.args, node.keywords)
        case ast.Call(args=[one, two, *rest]) if not isinstance(one, ast.Starred):
            yield ast.Call(node.func, [two, one, *rest], node.keywords)


def nodes(tree):
    """Yield the nodes of a tree but those of annotations, imports, messages and `strict=`."""
    yield tree
    for name, field in ast.iter_fields(tree):
        children = field if isinstance(field, list) else [field]
        for child in () if name in ("annotation", "returns") else children:
            message = isinstance(child, ast.Raise | ast.JoinedStr | ast.Import | ast.ImportFrom)
            if isinstance(child, ast.AST) and not message and getattr(child, "arg", "") != "strict":
                yield from nodes(child)


def mutants():
    """Yield file, line, text before and after, and the bytes between which it stands."""
    for path in sorted((ROOT / SOURCE).rglob("*.py")):
        name, lines = path.relative_to(ROOT / SOURCE).as_posix(), path.read_bytes().splitlines(keepends=True)
        for node in () if name.startswith(LEFT_OUT) else nodes(ast.parse(b"".join(lines))):
            for new in slips(node):
                ends = (node.lineno, node.col_offset), (node.end_lineno, node.end_col_offset)
                after = ast.unparse(new) if isinstance(new, ast.stmt) else f"({ast.unparse(new)})"
                place = [sum(map(len, lines[: line - 1])) + column for line, column in ends]
                yield name, node.lineno, ast.unparse(node), after, *place


class Map:
    """A plug-in of pytest: which test runs which line, and how long it takes."""

    def __init__(self, path):
        self.path, self.test, self.lines, self.seconds = path, "", defaultdict(set), defaultdict(float)
        monitor, this = sys.monitoring, sys.monitoring.COVERAGE_ID
        monitor.use_tool_id(this, "mutation")
        monitor.register_callback(this, monitor.events.LINE, self.run)
        monitor.set_events(this, monitor.events.LINE)

    def run(self, code, line):
        if self.test and code.co_filename.startswith(f"{ROOT}/{SOURCE}"):
            self.lines[f"{code.co_filename.removeprefix(f'{ROOT}/{SOURCE}')}:{line}"].add(self.test)
        return sys.monitoring.DISABLE  # until the next test

    def pytest_runtest_logstart(self, nodeid):
        self.test = nodeid
        sys.monitoring.restart_events()

    def pytest_runtest_logreport(self, report):
        self.seconds[report.nodeid] += 1e9 if report.outcome == "failed" else report.duration

    def pytest_sessionfinish(self):
        lines = {line: sorted(tests) for line, tests in self.lines.items()}
        self.path.write_text(json.dumps({"lines": lines, "seconds": self.seconds}))


def judges(known, name, line):
    """Yield the tests that run a line, those of its package first, quickest first: of two files, then of the others.

    Where there are none, as of a line that is run at import, those of the package.
    """
    package, seconds = f"tests/{name.split('/')[0].removesuffix('.py')}/", known["seconds"]
    tests = known["lines"].get(f"{name}:{line}") or [test for test in seconds if test.startswith(package)]
    tests = sorted(tests, key=lambda test: (not test.startswith(package), seconds[test]))
    files = list(dict.fromkeys(test.partition("::")[0] for test in tests))
    for some in (files[:2], files[2:]):
        given = [test for test in tests if test.partition("::")[0] in some]
        spent = itertools.accumulate(seconds[test] for test in given)
        yield [test for test, total in zip(given, spent, strict=True) if total < ENOUGH]


def killer(tree, tests):
    """Return what fails of some tests in a copy of the project, how it ends, or nothing."""
    variables = {"PYTHONPATH": f"{tree}/src:{tree}", "CONTACTBENCH_CACHE": f"{tree}/cache"}
    command = [sys.executable, "-m", "pytest", "-xq", "-p", "no:cacheprovider", "--tb=no", *tests]
    given = {"cwd": tree, "env": os.environ | variables, "capture_output": True, "timeout": MOST}
    try:
        done = subprocess.run(command, text=True, errors="replace", **given)
    except subprocess.TimeoutExpired:
        return f"longer than {MOST} s"
    if done.returncode == 4 and any("::" in test for test in tests):  # one has another name than in the map
        return killer(tree, sorted({test.partition("::")[0] for test in tests}))
    failed = (line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR")))
    return next(failed, f"exit {done.returncode}" if done.returncode else "")


def judge(folder, count, seed=40):
    known, path = json.loads((folder / "map.json").read_text()), folder / "mutants.jsonl"
    done = len(path.read_text().splitlines()) if path.exists() else 0
    drawn = random.Random(int(seed)).sample([*mutants()], int(count))
    for name, line, before, after, first, last in drawn[done:]:
        with tempfile.TemporaryDirectory() as tree, path.open("a") as file:
            ignored = shutil.ignore_patterns(".git", "__pycache__", ".venv", ".tox")
            shutil.copytree(ROOT, tree, dirs_exist_ok=True, ignore=ignored)
            place = Path(tree) / SOURCE / name
            place.write_bytes((text := place.read_bytes())[:first] + after.encode() + text[last:])
            found = (killer(tree, tests) for tests in judges(known, name, line) if tests)
            print(json.dumps([name, line, before, after, next(filter(None, found), "")]), file=file)


if __name__ == "__main__":
    where, what, *more = sys.argv[1:]
    Path(where).mkdir(exist_ok=True)
    if what == "map":
        pytest.main(more, plugins=[Map(Path(where) / "map.json")])
    else:
        judge(Path(where), *more)

"""What is run, asked, told and judged follows from what methods and scenes declare, not from lists of their names."""

import ast
from pathlib import Path

import contactbench as cb
from contactbench.plugins import OWN

ROOMS = ("runs", "questions", "report", "gate", "measure")
#: names of documents that are about a method or a scene, and of the formulas that are known of one
MOST = 30
SOURCE = Path(cb.__file__).parent


def literals(path):
    """The names of methods and scenes that a module writes as text of its own."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    return [node.value for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value in OWN]


def test_few_names_of_methods_and_scenes_stand_in_what_runs_and_tells():
    found = {
        f"{room}/{path.name}": names
        for room in ROOMS
        for path in sorted((SOURCE / room).rglob("*.py"))
        if (names := literals(path))
    }
    count = sum(map(len, found.values()))
    assert count <= MOST, f"{count}: {found}"

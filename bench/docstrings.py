"""Check that the docstrings of the public names and of the base classes of the contracts are in numpydoc's form.

    python bench/docstrings.py

Which of numpydoc's checks are made stands in pyproject.toml.  Attributes count as parameters of a class that no user
makes.
"""

import dataclasses
import enum
import inspect
import sys
import tomllib
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

from numpydoc.docscrape import get_doc_object
from numpydoc.validate import Validator, validate

MODULES = [f"contactbench{part}" for part in ("", ".interop.scipy", ".interop.diffrax", ".testing")]
CONTRACTS = {
    "methods.base": ["Method"],
    "methods.fixed_step_run": ["FixedStepRun"],
    "methods.loops": ["StepLoop"],
    "methods.one_step": ["OneStep"],
    "methods.prepared": ["Prepared"],
    "measure.law": ["Law"],
    "scene.base": ["Scene"],
    "scene.flow": ["Flow"],
    "splitting.composition": ["Composition"],
}
#: takes minutes: docs/compare.md shows it
NO_EXAMPLE = {"contactbench.study.compare.compare"}


class Documented(Validator):
    def __init__(self, obj_name: str) -> None:
        super().__init__(get_doc_object(self._load_obj(obj_name)))

    source_file_def_line = 1  # where to look for comments that switch checks off: there are none

    @property
    def signature_parameters(self) -> tuple[str, ...]:
        """Return what a dataclass is made of, whatever its ``__new__`` takes; nothing makes a member of an enum."""
        if dataclasses.is_dataclass(self.obj):
            return tuple(inspect.signature(self.obj.__init__).parameters)[1:]
        return () if isinstance(self.obj, enum.EnumType) else super().signature_parameters

    @property
    def doc_all_parameters(self) -> dict:
        own = self.signature_parameters
        attributes = self._doc_parameters(["Attributes"])
        return {name: attributes[name] for name in attributes if name in own} | super().doc_all_parameters


def names() -> Iterator[str]:
    """Yield the names under which the objects are defined; of a registry, which is no class, that of its class."""
    yield from MODULES
    wanted = {module: import_module(module).__all__ for module in MODULES}
    wanted |= {f"contactbench.{module}": classes for module, classes in CONTRACTS.items()}
    for module, inside in wanted.items():
        for found in (getattr(import_module(module), name) for name in inside):
            if isinstance(found, ModuleType):
                yield found.__name__
            else:
                found = found if hasattr(found, "__qualname__") else type(found)
                yield f"{found.__module__}.{found.__qualname__}"


def faults(name: str, checks: set[str]) -> Iterator[str]:
    report = validate(name, Documented)
    needs_example = report["type"] == "function" and name not in NO_EXAMPLE
    for code, message in report["errors"]:
        if code in checks and (code != "EX01" or needs_example):
            yield f"{name}: {code} {message}"


def main() -> int:
    settings = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8"))
    checks = set(settings["tool"]["numpydoc_validation"]["checks"])
    found = [fault for name in dict.fromkeys(names()) for fault in faults(name, checks)]
    print(*found, f"{len(found)} faults in docstrings", sep="\n")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())

"""Load a user's methods and scenes from a file (``--plugin my.py``) or from an installed package.

A file registers its methods and scenes by `fixed_step`, ``METHODS.add`` or ``SCENES.add``.  The environment
(`VARIABLE`) then names the file, so that worker processes load it too.  A package has entry points in the groups
``contactbench.methods`` and ``contactbench.scenes``, loaded with contactbench.  An entry point is a method or a scene,
a list of them, a function without arguments that returns either, or any object whose module registers by itself.
"""

from __future__ import annotations

import hashlib
import importlib.util
import os
import sys
import warnings
from importlib.machinery import SourceFileLoader
from importlib.metadata import entry_points
from pathlib import Path

from contactbench.blame import their_code, user_error
from contactbench.errors import BadInput, one_line
from contactbench.methods import METHODS
from contactbench.methods.fixed_step import FixedStep
from contactbench.registry import Registry
from contactbench.scene import Scene, verify
from contactbench.scenes import SCENES

GROUPS: dict[str, Registry] = {"contactbench.methods": METHODS, "contactbench.scenes": SCENES}

#: names of the methods and scenes of this package
OWN = frozenset({*METHODS, *SCENES})


def brought() -> set[str]:
    """Return the names of the methods and scenes from plug-ins."""
    return {*METHODS, *SCENES} - OWN


#: files to load when contactbench is imported, separated as in PATH
VARIABLE = "CONTACTBENCH_PLUGINS"

#: loaded plug-in → its SHA-256 or version, for the provenance of rows
LOADED: dict[str, str] = {}
_files: set[Path] = set()


def load_file(path: Path | str) -> None:
    """Run a Python file once, and evaluate each method and scene that it registers; `BadInput` if that fails."""
    path = Path(path)
    if not path.is_file():
        raise BadInput(f"plug-in {path}: no such file")
    file = path.resolve()
    if file in _files:
        return
    before = _registered()
    try:
        _run(file)
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise user_error(f"plug-in {path}", error) from error
    new = [item for key, item in _registered().items() if key not in before]
    if not new:
        raise BadInput(f"plug-in {path}: registers nothing (cb.fixed_step, cb.SCENES.add, …)")
    for item in new:
        try_out(item)
    _files.add(file)
    named = list(filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)))
    os.environ[VARIABLE] = os.pathsep.join(dict.fromkeys([*named, str(file)]))
    LOADED[path.name] = f"sha256 {hashlib.sha256(file.read_bytes()).hexdigest()}"


def _registered() -> dict[tuple[str, int], object]:
    """Return all registered items by name and identity, since a file may replace some."""
    return {(name, id(item)): item for registry in Registry.every for name, item in registry.items()}


def _run(path: Path) -> None:
    """Run the file as a module; it can import files beside it, as a script can."""
    name = f"contactbench_plugin_{path.stem}"
    loader = SourceFileLoader(name, str(path))
    spec = importlib.util.spec_from_loader(name, loader)
    assert spec is not None
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    sys.modules[name] = importlib.util.module_from_spec(spec)
    loader.exec_module(sys.modules[name])


def try_out(item: object) -> None:
    """Evaluate a scene's functions, or a step map on a scene, once; raise `BadInput` if that fails."""
    if isinstance(item, Scene):
        verify(item)
    elif isinstance(item, FixedStep):
        with their_code(f"method {item.name!r}"):
            scene = next((scene for scene in SCENES.values() if item.refuses(scene) is None), None)
        if scene is not None:
            item.try_step(scene, scene.carry())


def load_installed() -> None:
    """Load entry points and the files named in the environment; warn of broken ones."""
    installed = entry_points()  # slow, so once for both groups
    for group, registry in GROUPS.items():
        for point in installed.select(group=group):
            try:
                _register(registry, point.load())
            except KeyboardInterrupt:
                raise
            except BaseException as error:
                _warn(f"entry point {point.name!r} of group {group!r} ({point.value})", error)
            else:
                made = f"{point.dist.name} {point.dist.version}" if point.dist else point.value
                LOADED[f"{group}: {point.name}"] = made
    for path in filter(None, os.environ.get(VARIABLE, "").split(os.pathsep)):
        try:
            load_file(path)
        except BadInput as error:
            _warn(f"{VARIABLE}={path}", error)


def _warn(what: str, error: BaseException) -> None:
    message = f"{what} is left out: {type(error).__name__}: {one_line(error, 200)}"
    warnings.warn(message, RuntimeWarning, stacklevel=3)


def _register(registry: Registry, item: object) -> None:
    """Register the object of an entry point, unless importing its module has done so."""
    if any(item is known or item is getattr(known, "step", None) for known in registry.values()):
        return
    if callable(item) and not hasattr(item, "name"):
        item = item()
    for each in item if isinstance(item, list | tuple) else [item]:
        if each is not None and not any(each is known for known in registry.values()):
            registry.add(each)

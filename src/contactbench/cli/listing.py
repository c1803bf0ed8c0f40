"""The command ``contactbench list``: names with a line each, or one name with all that it declares."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

from contactbench.cli.printing import print_item

if TYPE_CHECKING:
    from contactbench.methods.base import Method
    from contactbench.registry import Registry
    from contactbench.scene import Scene

#: from these orders on a method suits moderate and small errors
MODERATE, SMALL = 4, 8
#: a method that runs on so few scenes names them
FEW = 3
#: columns of a name and of a label
NAMES, LABELS = 25, 11


def listing(arguments: argparse.Namespace) -> int:
    import contactbench as cb
    from contactbench.paper import CLAIMS

    registries: dict[str, Registry] = {
        "scenes": cb.SCENES,
        "methods": cb.METHODS,
        "laws": cb.LAWS,
        "claims": CLAIMS,
    }
    if arguments.name is not None:
        item = registries[arguments.kind][arguments.name]
        print_item(f"{'name':{LABELS}}", item.name, LABELS)
        for label, text in DETAILS[arguments.kind](item):
            print_item(f"{label:{LABELS}}", text, LABELS)
        return 0
    for kind in [arguments.kind] if arguments.kind else registries:
        if not arguments.kind:
            print(kind)
        indent = "" if arguments.kind else "  "
        for name, item in registries[kind].items():
            _, text = next(DETAILS[kind](item))
            print_item(f"{indent}{name:{NAMES - 1}} ", text, len(indent) + NAMES)
    return 0


def order_of(method: Method) -> str:
    if method.order:
        return f"order {method.order}"
    return "exact" if method.exact else "variable order"


def good_for(method: Method) -> str:
    """Return the problems that a method suits, in the words that follow from its declared properties."""
    from contactbench.methods.base import CALLBACKS

    order = method.order or SMALL
    size = "small" if order >= SMALL else "moderate" if order >= MODERATE else "large"
    found = {
        f"for {size} errors": not method.exact,
        "by tolerance": method.adaptive,
        "close encounters": method.follows,
        "stiff motion": method.stiff,
        "forces in plain Python": {*method.engines} <= {*CALLBACKS},
        "long runs": not (method.one_step or method.follows),
        "any H(q, p, s)": method.contact and method.iterates,
    }
    return ", ".join(words for words, true in found.items() if true)


def keeps(method: Method) -> str:
    """Return the laws that a method keeps at every step size."""
    from contactbench.methods.base import FAMILIES

    found = {"η": method.contact, "J": method.family == FAMILIES[0] and not method.expands}
    return " and ".join(words for words, true in found.items() if true)


# -- all that an item declares; the first line stands in its list ---------------------------------------
def of_method(method: Method) -> Iterator[tuple[str, object]]:
    import contactbench as cb
    from contactbench.methods.base import CALLBACKS

    kept, lacks = keeps(method), method.lacks(method.engines[0])
    fits = [scene for scene in cb.SCENES.values() if method.refuses(scene) is None]
    few = ", ".join(scene.name for scene in fits) if 0 < len(fits) <= FEW else ""
    suits = good_for(method), f"keeps {kept}" if kept else "", few and f"runs only on {few}", lacks
    yield "good for", f"{order_of(method)}: {'; '.join(filter(None, suits))}"
    yield "steps", f"chosen by rtol, which bounds {method.tolerance}" if method.adaptive else method.stepping
    costs = [method.step_cost(fits[0], engine) for engine in method.engines if fits and engine in CALLBACKS]
    if any(costs):
        yield (
            "cost",
            f"about {costs[0]:g} evaluation{'s' if costs[0] != 1 else ''} per step on {fits[0].name}",
        )
    by_design = "by construction, at every step size"
    by_design += "" if method.expands else "; J where the potential has the symmetry"
    if method.contact and method.iterates:
        by_design += "; on a general H(q, p, s) the kernel of η alone"
    yield "keeps", f"{kept}, {by_design}" if kept else "the laws up to its error"
    yield "engines", ", ".join(method.engines)
    yield "scenes", f"{len(fits)} of {len(cb.SCENES)}"
    yield "source", method.about


def of_scene(scene: Scene) -> Iterator[tuple[str, object]]:
    import contactbench as cb

    yield "about", scene.about
    yield "kind", scene.kind
    yield from scene.values().items()
    yield "methods", ", ".join(name for name, each in cb.METHODS.items() if each.refuses(scene) is None)


DETAILS: dict[str, Callable[[Any], Iterator[tuple[str, object]]]] = {
    "scenes": of_scene,
    "methods": of_method,
    "laws": lambda law: iter([("about", law.definition)]),
    "claims": lambda claim: iter(
        [("claim", f"{claim.where}: {claim.says}"), ("measure", f"contactbench claim {claim.name}")]
    ),
}

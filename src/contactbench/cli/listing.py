"""The command ``contactbench list``: names with a line each, or one name with all that it declares."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from typing import TYPE_CHECKING

from contactbench.cli.printing import print_item

if TYPE_CHECKING:
    from contactbench.methods.base import Method
    from contactbench.paper import Claim
    from contactbench.registry import Registry
    from contactbench.scene import Scene

#: from these orders on a method suits moderate and small errors
MODERATE, SMALL = 4, 8
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
    """Return what a method suits and keeps, in the words that follow from its declared properties."""
    order = method.order or SMALL
    size = "small" if order >= SMALL else "moderate" if order >= MODERATE else "large"
    found = {
        f"{size} errors": not method.exact,
        "tolerances": method.adaptive,
        "close encounters": method.follows,
        "stiff motion": method.stiff,
        "long runs with few saved times": not (method.one_step or method.follows),
        "any H(q, p, s)": method.contact and method.iterates,
        "keeps the contact form": method.contact,
    }
    return ", ".join(words for words, true in found.items() if true)


def keeps(method: Method) -> str:
    """Return the laws that a method keeps at every size of steps."""
    from contactbench.methods.base import FAMILIES

    found = {"the contact form": method.contact, "J of a symmetry": method.family == FAMILIES[0]}
    return " and ".join(words for words, true in found.items() if true) or "no law beyond its error"


# -- all that an item declares; the first line stands in its list ---------------------------------------
def of_method(method: Method) -> Iterator[tuple[str, object]]:
    import contactbench as cb
    from contactbench.methods.base import CALLBACKS

    lacks = method.lacks(method.engines[0])
    yield "good for", f"{order_of(method)}: {good_for(method)}{f'; {lacks}' if lacks else ''}"
    yield "steps", f"chosen by rtol, which bounds {method.tolerance}" if method.adaptive else method.stepping
    fits = [scene for scene in cb.SCENES.values() if method.refuses(scene) is None]
    costs = [method.step_cost(fits[0], engine) for engine in method.engines if fits and engine in CALLBACKS]
    if any(costs):
        yield "cost", f"about {costs[0]:g} evaluations a step of {fits[0].name}"
    yield "keeps", keeps(method)
    yield "engines", ", ".join(method.engines)
    yield "scenes", f"{len(fits)} of {len(cb.SCENES)}"
    yield "source", method.about


def of_scene(scene: Scene) -> Iterator[tuple[str, object]]:
    import contactbench as cb

    yield "about", scene.about
    yield "kind", scene.kind
    yield from scene.values().items()
    yield "methods", ", ".join(name for name, each in cb.METHODS.items() if each.refuses(scene) is None)


def of_claim(claim: Claim) -> Iterator[tuple[str, object]]:
    yield "claim", f"{claim.where}: {claim.says}"
    yield "measure", f"contactbench claim {claim.name}"


DETAILS = {
    "scenes": of_scene,
    "methods": of_method,
    "laws": lambda law: iter([("about", law.definition)]),
    "claims": of_claim,
}

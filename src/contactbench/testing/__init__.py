"""Test whether methods and scenes keep their contracts, for those who bring their own.

    from contactbench.testing import check_method, check_scene
    check_method(cb.METHODS["mine"])

Each takes the numbered rules of the contract (`methods.base.Method`, `scene.base.Scene`) one after the other,
returns what it found, and raises `Violation`, an `AssertionError` that says which is broken and how.
"""

from contactbench.testing.method import METHOD_RULES, check_method, method_findings
from contactbench.testing.rules import Finding, Violation
from contactbench.testing.scene import SCENE_RULES, check_scene, scene_findings

__all__ = ["Finding", "Violation", "check_method", "check_scene"]

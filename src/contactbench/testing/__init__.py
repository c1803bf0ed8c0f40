"""Check that your own methods and scenes keep the contracts of this package.

    from contactbench.testing import check_method, check_scene
    check_method(cb.METHODS["mine"])

Each checks the numbered rules of its contract (`methods.base.Method`, `scene.base.Scene`) in turn, returns a finding
per rule, and raises `Violation`, an `AssertionError` that names the broken rule and how it is broken.
"""

from contactbench.testing.method import METHOD_RULES, check_method, method_findings
from contactbench.testing.rules import Finding, Violation
from contactbench.testing.scene import SCENE_RULES, check_scene, scene_findings

__all__ = ["Finding", "Violation", "check_method", "check_scene"]

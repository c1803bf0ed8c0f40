"""Digests of scenes and methods: every number is in them, and nothing of the machine."""

from dataclasses import replace

import pytest

import contactbench as cb
import planted_faults
from contactbench.methods.contact import contact_method
from contactbench.runs.definitions import FOLLOWED, STEPPED, method_lines, row
from contactbench.splitting.tables import COMPOSITIONS


@pytest.mark.parametrize("scene", cb.SCENES.values(), ids=cb.SCENES)
def test_every_number_of_a_scene_is_in_its_digest(scene):
    """A part in 10¹⁵ of any, the smallest change a float has room for."""
    numbers = {"t_end": scene.t_end, "s": scene.s, **vars(scene), **getattr(scene, "parameters", {})}
    names = {name for name in ("t_end", "s", *scene.number_names()) if isinstance(numbers.get(name), float)}
    changed = [scene.with_(**{name: numbers[name] * (1 + 1e-15) or 1e-15}) for name in names]
    digests = {row(each)["digest"] for each in [scene, *changed]}
    assert len(digests) == 1 + len(names) > 2


def test_a_function_of_a_scene_is_in_its_digest_and_its_words_are_not():
    particle = cb.SCENES["particle"]
    potential = particle.potential

    def other(*arguments, **more):
        return potential(*arguments, **more) * (1 + 2**-52)

    assert row(replace(particle, potential=other))["digest"] != row(particle)["digest"]
    assert row(replace(particle, about="other words"))["digest"] == row(particle)["digest"]


@pytest.mark.parametrize("composition", COMPOSITIONS, ids=lambda composition: composition.name)
@pytest.mark.quick(composition=("contact-abc", "contact-rkn6", "contact-o8"))
def test_every_coefficient_of_a_method_is_in_its_digest(composition):
    rows = [row(contact_method(each)) for each in (composition, *planted_faults.faulty(composition))]
    assert len({each["digest"] for each in rows}) == len(rows)


@pytest.mark.parametrize("method", cb.METHODS.values(), ids=cb.METHODS)
def test_no_line_of_a_digest_is_an_address_in_memory(method):
    lines = method_lines(method)
    assert not [line for line in lines if " at 0x" in line]
    assert f"name={method.name!r}" in lines
    stepped = tuple(f"{scene} [" for scene in (*STEPPED, FOLLOWED))
    assert any(line.startswith(stepped) for line in lines) == hasattr(method, "advance")

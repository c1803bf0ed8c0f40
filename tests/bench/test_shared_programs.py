"""Several processes share the untimed cells: what is compiled alike is in one of them."""

from __future__ import annotations

from cells import family


def test_programs_are_the_same_for_scenes_of_one_force_and_method():
    assert family(("particle", "rk4", 30.0)) == family(("escape", "rk4")) == family(("particle_long", "rk4"))
    assert family(("weak_damping 1e+04", "rk4")) == family(("oscillator", "rk4"))
    others = [("particle", "rk4"), ("particle", "herglotz1"), ("central", "rk4"), ("C01",)]
    assert len(set(map(family, others))) == 4

"""Bad input is one line that names the value and what is allowed; the command line exits with 2."""

from __future__ import annotations

import math

import pytest

import contactbench as cb
from contactbench.cli import main

CASES = [
    (("partcle", "rk4", {"step": 0.1}), "unknown scene 'partcle': did you mean 'particle'?"),
    (("particle", "contact-strnag", {"step": 0.1}), "did you mean 'contact-strang'?"),
    (("particle", "rk4", {"step": -0.1}), "step = -0.1: must be > 0"),
    (("particle", "rk4", {"step": 0}), "step = 0: must be > 0"),
    (("particle", "rk4", {"step": math.nan}), "step = nan: must be a finite number"),
    (("particle", "rk4", {"step": "small"}), "step = 'small'"),
    (("particle", "rk4", {}), "give step > 0, or rtol"),
    (("particle", "rk4", {"rtol": 1e-6, "step": 0.1}), "give step > 0, or rtol"),
    (("particle", "rk4", {"rtol": 1e-20}), "rk4 takes 1e-13 to 0.1"),
    (("particle", "cvode-bdf", {"step": 0.1}), "give rtol"),
    (("particle", "cvode-bdf", {}), "rtol is missing"),
    (("particle", "cvode-bdf", {"rtol": 1e-30}), "takes 1e-14 to 0.1"),
    (("particle", "scipy-dop853", {"rtol": -1}), "rtol = -1: must be > 0"),
    (("particle", "rk4", {"step": 0.1, "engine": "fortran"}), "engine = 'fortran': rk4 runs on numba, jax, python"),
    (("particle", "rk4", {"step": 0.1, "save_at": [3.0, 1.0]}), "strictly increasing"),
    (("particle", "rk4", {"step": 0.1, "save_at": [1.0, math.nan]}), "must be finite times"),
    (("particle", "rk4", {"step": 0.1, "save_at": []}), "must be finite times"),
    (("particle", "rk4", {"step": 0.1, "carry": ("R",)}), "can carry s"),
    (("particle", "rk4", {"step": 0.1, "max_steps": 0}), "max_steps = 0"),
]  # fmt: skip


@pytest.mark.parametrize(("call", "says"), CASES, ids=[says for _, says in CASES])
def test_solve_says_what_is_wrong_in_one_line(call, says):
    scene, method, options = call
    with pytest.raises(cb.BadInput) as caught:
        cb.solve(scene, method, **options)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_registries_suggest_the_nearest_name():
    for registry, wrong, right in (
        (cb.SCENES, "rigidbody", "rigid_body"),
        (cb.METHODS, "RK4", "rk4"),
        (cb.LAWS, "momentum", "momentum_law"),
    ):
        with pytest.raises(KeyError) as caught:
            registry[wrong]
        assert isinstance(caught.value, cb.UnknownName)
        assert f"did you mean {right!r}?" in str(caught.value) or right in str(caught.value)


def test_prepared_solver_checks_its_initial_data():
    run = cb.prepare("particle", "rk4", step=0.1)
    with pytest.raises(cb.BadInput, match="q has 1 components"):
        run(q=(1.0,))
    with pytest.raises(cb.BadInput, match="unknown initial value"):
        run(M=(1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("argv", "says"),
    [
        (["solve", "particle", "rk5", "--step", "0.1"], "did you mean 'rk4'?"),
        (["solve", "particle", "rk4", "--step", "-1"], "step = -1.0: must be > 0"),
        (["solve", "particle", "rk4", "--step", "0.1", "--t-end", "nan"], "t_end = nan"),
        (["solve", "particle", "rk4", "--step", "0.1", "--set", "q=[1]"], "q has 1 components and p 2"),
        (["solve", "particle", "rk4", "--step", "0.1", "--set", "gamma=abc"], "--set gamma=abc"),
        (["report", "--results", "/nonexistent"], "no tables there"),
    ],
)
def test_command_line_prints_one_line_and_exits_2(argv, says, capsys):
    assert main(argv) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert says in err
    assert err.count("\n") == 1
    assert err.startswith("contactbench: ")


def test_command_line_solves_and_prints_json(capsys):
    import json

    argv = ["solve", "particle", "contact-strang", "--step", "0.01", "--set", "gamma=0.3", "--json"]
    assert main(argv) == 0
    out = json.loads(capsys.readouterr().out)
    assert out["status"] == "ok"
    assert set(out["state"]) == {"q1", "q2", "p1", "p2", "s"}
    assert out["counts"]["evaluations"] == 2001
    # H decays as e^{-γt}: an independent check on the printed number
    start = 0.625 + 0.045 + 0.05
    assert out["H"] == pytest.approx(start * math.exp(-0.3 * 20), rel=1e-3)


def test_command_line_tells_the_stored_references(capsys):
    assert main(["references"]) == 0
    lines = capsys.readouterr().out.splitlines()
    names = [line.split()[0] for line in lines]
    assert names == [name for name in cb.SCENES if name in names]  # a plug-in's have none
    assert {"particle", "rigid_body"} <= set(names)
    assert all(int(line.split()[1]) >= 30 for line in lines)


def test_command_line_lists_everything(capsys):
    assert main(["list"]) == 0
    out = capsys.readouterr().out
    for name in [*cb.SCENES, *cb.METHODS, *cb.LAWS]:
        assert f"  {name} " in out

"""What is asked of an adaptive method reaches its library as it was asked: no peer is given a handicap.

Tolerances, budget, final time and kind of solver are taken down where they are handed over.  Of what is compiled
they are not seen on the way: there the same library is called in another way, with what was asked, for the same bits.
"""

from types import SimpleNamespace

import diffrax
import numpy as np
import pytest
import scipy.integrate
import sksundae.cvode
from CyRK import pysolve_ivp

import contactbench as cb
from cases import c_functions, mine
from contactbench.solution import Status
from contactbench.xla import jnp

#: asked for; numbers that nothing has by default, and tolerances that both act
END, RTOL, ATOL, BUDGET = 1.7, 3.1e-5, 4.3e-5, 4321
ASKED = {"rtol": RTOL, "atol": ATOL, "max_num_steps": BUDGET}


def tolerances(name):
    return {"rtol": RTOL, **({"atol": ATOL} if cb.METHODS[name].takes_atol else {})}


DATA = {"gamma": 0.3, "q": (0.9, -0.7, 0.4, 0.2), "p": (0.1, 0.6, -0.5, 0.3), "s": 0.2, "t_end": END}
#: two pairs of springs, nine components
SCENE = cb.Mechanical(
    name="asked",
    potential=lambda q: (
        sum(0.53 * c * c + 0.21 * c * c * c * c for c in q) + 0.37 * (q[0] * q[1] + q[2] * q[3])
    ),
    gradient=lambda q: tuple(1.06 * c + 0.84 * c * c * c + 0.37 * q[i ^ 1] for i, c in enumerate(q)),
    hessian=lambda q: tuple(
        tuple(1.06 + 2.52 * c * c if i == j else 0.37 * (i // 2 == j // 2) for j in range(4))
        for i, c in enumerate(q)
    ),
    **DATA,
)
#: what each is in its library
KINDS = {("scipy-dop853", "python"): "DOP853", ("scipy-radau", "python"): "Radau"}
KINDS |= {(f"cvode-{kind.lower()}", e): kind for kind in ("Adams", "BDF") for e in ("c", "c+python")}
KINDS |= {(f"cyrk-{kind.lower()}", "c++"): kind for kind in ("DOP853", "Vern8", "LSODA", "RADAU")}
KINDS |= {(f"diffrax-{kind.lower()}", "jax"): kind for kind in ("Tsit5", "Dopri8", "Kvaerno5")}
KINDS |= {("heyoka-taylor", "llvm"): None}
ADAPTIVE = [(m.name, e) for m in cb.METHODS.values() if m.adaptive and m.package for e in m.engines]


def of(*libraries):
    chosen = [pair for pair in KINDS if pair[0].partition("-")[0] in libraries]
    return pytest.mark.parametrize(("name", "engine"), chosen, ids=["-".join(pair) for pair in chosen])


saved = pytest.mark.parametrize("times", [[END], [0.0, 0.6, END]], ids=["end", "grid"])


def prepared(name, engine, times):
    return cb.prepare(SCENE, name, engine=engine, save_at=times, max_steps=BUDGET, **tolerances(name))


def calls(run):
    solution = run()
    assert solution.ok
    run.bare(run.start)


def test_every_adaptive_method_is_looked_at():
    assert {*KINDS} == {*ADAPTIVE}


# -- called from Python ----------------------------------------------------------------------------
@of("scipy")
@saved
def test_scipy(name, engine, times, monkeypatch):
    seen = []

    def recorded(kind, solver):
        def made(f, t0, y0, t_bound, **options):
            seen.append({"kind": kind, "t0": t0, "t_bound": t_bound} | options)
            return solver(f, t0, y0, t_bound, **options)

        return made

    for kind in ("RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"):
        monkeypatch.setattr(scipy.integrate, kind, recorded(kind, getattr(scipy.integrate, kind)))
    calls(prepared(name, engine, times))
    asked = {"kind": KINDS[name, engine], "t0": 0.0, "t_bound": END, "rtol": RTOL, "atol": ATOL}
    assert len(seen) == 2
    for got in seen:
        got.pop("jac", None)
        assert got == asked


@saved
def test_heyoka(times, monkeypatch):
    seen = []
    # at another tolerance before: every one has a program of its own
    kind = type(cb.prepare(SCENE, "heyoka-taylor", rtol=1e-9, save_at=times).call.integrator)

    def recorded(propagate):
        def noted(self, t, **options):
            seen.append({"tol": self.tol, "end": np.ravel(t)[-1]} | options)
            return propagate(self, t, **options)

        return noted

    for name in ("propagate_until", "propagate_grid"):
        monkeypatch.setattr(kind, name, recorded(getattr(kind, name)))
    calls(prepared("heyoka-taylor", "llvm", times))
    assert seen == 2 * [{"tol": RTOL, "end": END, "max_steps": BUDGET}]


# -- set up from Python, run in C ------------------------------------------------------------------
@of("cyrk")
@saved
def test_cyrk_by_its_call_from_python(name, engine, times):
    """The run's own functions, called back, and what was asked: every bit, and as many steps."""
    run = prepared(name, engine, times)
    rhs, *_ = c_functions(SCENE, run.request.carry)
    found = pysolve_ivp(rhs, (0.0, END), run.start.copy(), method=KINDS[name, engine], **ASKED)
    out = run.integrate(run.start)
    for y in (out.y[-1], run.bare(run.start)):
        np.testing.assert_array_equal(y, found.y[:, -1])
    assert out.counts.steps == found.steps_taken


@of("cvode")
@saved
def test_cvode_by_scikit_sundae(name, engine, times):
    run = prepared(name, engine, times)
    by_python = engine == "c+python"
    rhs, jacobian = (
        (run.call.rhs, run.call.jacobian) if by_python else c_functions(SCENE, run.request.carry)[:2]
    )

    def f(t, y, yp):
        yp[:] = rhs(t, y)

    def jac(t, y, yp, J):
        J[:, :] = jacobian(t, y)

    steps = {"max_step": END, "min_step": 1e-15 * END}
    solver = sksundae.cvode.CVODE(f, method=KINDS[name, engine], jacfn=jac, **ASKED, **steps)
    solver.init_step(0.0, run.start)
    found = solver.step(END, tstop=END).y
    np.testing.assert_array_equal(run().y[-1], found)
    np.testing.assert_array_equal(run.bare(run.start), found)


# -- compiled by XLA -------------------------------------------------------------------------------
def other_than_default(thing, default, *but):
    """Fields in which two of a kind differ."""
    return [
        name for name in vars(default) if name not in but and getattr(thing, name) != getattr(default, name)
    ]


@of("diffrax")
@saved
def test_diffrax(name, engine, times, monkeypatch):
    """In place of `diffeqsolve` what returns the numbers it is given, as the states: they are known to XLA only."""
    seen, default = [], diffrax.PIDController(rtol=0.1, atol=0.1, dtmin=0.1, force_dtmin=False)

    def returns_what_it_gets(terms, solver, t0, t1, dt0, y0, *, saveat, stepsize_controller, **options):
        pid = stepsize_controller
        finder = getattr(solver, "root_finder", pid)  # an explicit method has none
        changed = other_than_default(pid, default, "rtol", "atol", "dtmin")
        seen.append((type(solver).__name__, type(pid), dt0, changed))
        numbers = [pid.rtol, pid.atol, finder.rtol, finder.atol]
        numbers += [options["max_steps"], options["throw"], t1, pid.dtmin, t0]
        y = jnp.stack([jnp.asarray(number, dtype=float) for number in numbers])[None]
        stats = dict.fromkeys(("num_accepted_steps", "num_rejected_steps"), 1)
        ys, ts = y, t1[None]
        if isinstance(saveat.subs, list):
            ys, ts = (y, jnp.tile(y, (len(saveat.subs[1].ts), 1))), (ts,)
        return SimpleNamespace(stats=stats, result=diffrax.RESULTS.successful, ys=ys, ts=ts)

    monkeypatch.setattr(diffrax, "diffeqsolve", returns_what_it_gets)
    run = prepared(name, engine, times)
    asked = [RTOL, ATOL, RTOL, ATOL, BUDGET, False, END, 1e-15 * END, 0.0]
    np.testing.assert_allclose(run.bare(run.start), asked, rtol=1e-15)
    assert set(map(str, seen)) == {str((KINDS[name, engine], diffrax.PIDController, None, []))}


# -- budgets, and the steps of our own ---------------------------------------------------------------
@pytest.mark.parametrize(("name", "engine"), [pair for pair in ADAPTIVE if pair[1] != "jax"])
@saved
def test_the_budget_is_the_one_asked_for(name, engine, times):
    """Enough for the run, and one step less is not; diffrax's is looked at above."""
    options = {**tolerances(name), "save_at": [4 * time for time in times], "engine": engine}
    scene = SCENE.with_(t_end=4 * SCENE.t_end)
    steps = cb.solve(scene, name, **options).counts.steps
    assert cb.solve(scene, name, max_steps=steps, **options).ok
    assert cb.solve(scene, name, max_steps=steps - 1, **options).status is Status.budget


#: solvers that do not count their rejected steps, and take no fixed number of evaluations for one
SILENT = ("scipy-radau", "cyrk-radau", "cyrk-lsoda")


@pytest.mark.parametrize(("name", "engine"), [pair for pair in KINDS if pair[1] != "jax"])
@pytest.mark.parametrize("times", [[20.0], None], ids=["end", "grid"])
def test_rejected_steps_are_counted_or_known_not_to_be(name, engine, times):
    """Pericentre after pericentre of an eccentric orbit, where there must be some, but for Taylor's steps."""
    scene = cb.SCENES["kepler_drag"].with_(t_end=20.0)
    counts = cb.solve(scene, name, rtol=1e-6, save_at=times, engine=engine).counts
    if name in SILENT or engine == "c+python" or (engine == "c++" and times is None):
        assert counts.rejected is None
    else:
        assert counts.rejected < counts.steps
        assert (counts.rejected > 0) == (name != "heyoka-taylor")


def test_heyoka_steps_into_a_wall_at_a_low_order_only():
    """As its module says: at order 12 the terms of e^{50(q − 1)} still rise; energy that damping has taken hides it."""
    wall = mine(lambda q: cb.math.exp(50 * (q[0] - 1)), 0.0, 1.0, 5.0, gamma=0.1)
    true = cb.reference(wall, [5.0], ()).y
    runs = [cb.solve(wall, "heyoka-taylor", rtol=rtol, save_at=[5.0], carry=()) for rtol in (1e-9, 1e-15)]
    loose, tight = (np.abs(run.y - true).max() for run in runs)
    assert all(run.ok for run in runs)
    assert loose > 1e-4 > 1e-11 > tight
    assert runs[0].laws().loc["solution_error", "deviation"] > 1e-4

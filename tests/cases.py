"""Shared by the tests: scenes to run on, random states, high-precision twins."""

import ctypes
import os
import subprocess
import sys
import time
from contextlib import contextmanager
from importlib import import_module
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from mpmath import mp

import contactbench as cb
from contactbench.methods.fixed_step import FixedStep
from contactbench.numbers import functions as xm
from contactbench.peers import compiled
from contactbench.scene import DrivenState
from contactbench.scenes.driven import FORCED_OSCILLATOR, spherical, spherical_span

REPOSITORY = Path(__file__).parents[1]


class MallInfo(ctypes.Structure):
    """The answer of glibc's `mallinfo2`: ten sizes, of which the fifth (mapped) and the eighth are in use."""

    _fields_ = (("sizes", ctypes.c_size_t * 10),)


def handed_out() -> int:
    """Return the bytes that the C library has handed out and not got back; 0 where it does not say."""
    library = ctypes.pythonapi  # as every process has it
    if not hasattr(library, "mallinfo2"):
        return 0
    library.mallinfo2.restype = MallInfo
    sizes = library.mallinfo2().sizes
    return sizes[4] + sizes[7]


DATA = {"q": (0.3, -0.2, 0.5), "p": (0.1, 0.4, -0.6), "s": 0.2, "gamma": 0.2, "mass": 2.0, "t_end": 2.0}
#: a scene a user might bring: no Hessian, and constants that are exact in every precision
USER = cb.Mechanical(
    name="user",
    potential=lambda q: q[0] * q[0] / 2 + q[1] * q[1] + q[2] * q[2] + q[0] * q[1] * q[2] / 4,
    gradient=lambda q: (q[0] + q[1] * q[2] / 4, 2 * q[1] + q[0] * q[2] / 4, 2 * q[2] + q[0] * q[1] / 4),
    **DATA,
)
#: a full symmetric D, whose axes are not the body's
TILTED = cb.SCENES["rigid_body_anisotropic"].with_(
    name="tilted", damping=((0.3, 0.1, 0.0), (0.1, 0.2, 0.05), (0.0, 0.05, 0.1))
)
#: the first scenes, of a plain mechanical system and a body; and those where runs may end badly
NAMES = ("oscillator", "particle", "central", "rigid_body", "rigid_body_anisotropic", "particle_long")
STANDARD = [cb.SCENES[name] for name in (*NAMES, "quadratic_damping")]
HARD = [scene for scene in cb.SCENES.values() if scene.hard]
TWO_SCALES = cb.SCENES["stiff_spring"].with_(omega=3.0)  # not so stiff that round-off tests feel it
#: methods with a step map
FIXED = [method for method in cb.METHODS.values() if isinstance(method, FixedStep)]
#: tests that ask the C library what it has handed out
counts_memory = pytest.mark.skipif(not handed_out(), reason="needs the C library of GNU")


def by_name(items):
    return pytest.mark.parametrize("scene", items, ids=lambda scene: scene.name)


def pairs(
    methods, scenes, applies=lambda method, scene: method.refuses(scene) is None, names=("method", "scene")
):
    """Parametrised over the pairs of a method, or a composition, and a scene to which a test applies.

    applies : by default where the method does not refuse the scene.
    """
    applicable = [(method, scene) for method in methods for scene in scenes if applies(method, scene)]
    chosen = [pytest.param(*pair, id=f"{pair[0].name}-{pair[1].name}") for pair in applicable]
    return pytest.mark.parametrize(names, chosen)


def few_slow(values, *slow):
    """The values of a parametrisation, or tuples of values, a few of them slow."""
    each = [(value, value if isinstance(value, tuple) else (value,)) for value in values]
    return [pytest.param(*given, marks=[pytest.mark.slow] if value in slow else []) for value, given in each]


def mine(potential, q=1.0, p=0.0, t_end=1.0, kind=cb.Mechanical, **more):
    """A scene of one coordinate, as users write them."""
    return kind(**{"name": "mine", "potential": potential, "q": (q,), "p": (p,), "t_end": t_end} | more)


def pulse(width=0.05, **changes):
    """A damped oscillator at rest until a pulse at 13.3."""
    bell = lambda t: cb.math.exp(-(((t - 13.3) / width) ** 2))  # noqa: E731
    own = {"q": 0.0, "t_end": 20.0, "gamma": 0.1} | changes
    return mine(lambda q, t: q[0] ** 2 / 2 - q[0] * bell(t), kind=cb.Driven, **own)


def after_pulse(width=0.05):
    """Return its (q, p) at 20: the pulse's convolution with the motion after a push, by the trapezoidal rule."""
    x = np.linspace(-7, 7, 2001)
    left, omega = 6.7 - width * x, np.sqrt(1 - 0.05**2)
    decay, c, s = np.exp(-0.05 * left), np.cos(omega * left), np.sin(omega * left)
    pushed = np.array([decay * s / omega, decay * (c - 0.05 * s / omega)])
    return pushed @ np.exp(-x * x) * width * (x[1] - x[0])


def refusal(call):
    """The message of a refusal: one line, short enough to be read."""
    with pytest.raises(cb.BadInput) as caught:
        call()
    assert len(str(caught.value)) <= 300
    assert str(caught.value).isprintable()
    return str(caught.value)


def saved(scene, count=5):
    return scene.t_end * np.arange(1, count + 1) / count


def random_state(scene, seed: int = 0, carry=None):
    """A generic state of a scene, its attitude a unit quaternion."""
    rng = np.random.default_rng(seed)
    carry = scene.carry(carry)
    y = rng.normal(size=len(scene.labels(carry)))
    if "R" in carry:
        y[3:7] /= np.linalg.norm(y[3:7])
    return scene.unpack(y.tolist(), carry)


def c_functions(scene, carry):
    """A scene's C functions as Python's, ``(t, y) -> slopes`` and ``(t, y) -> Jacobian``, and the data they share."""
    functions, size = compiled.c_functions(scene, carry), len(scene.without_clock(scene.labels(carry)))
    data = functions.data(scene.numbers())

    def called(address, *shape):
        function = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p)(
            address
        )

        def f(t, y):
            y, out = np.array(y), np.zeros(shape)  # as CVODE's matrix, of which zeros are left out
            function(out.ctypes.data, t, y.ctypes.data, data.ctypes.data)
            return out.T

        return f

    return called(functions.rhs, size), called(functions.jacobian, size, size), data


def in_mp(scene, x):
    """Scene and state with 50-digit numbers (the floats' decimal representations)."""
    exact = scene.with_numbers([mp.mpf(repr(v)) for v in scene.numbers()])
    carry = [f for f in scene.optional if getattr(x, f) is not None]
    return exact, scene.unpack([mp.mpf(repr(v)) for v in scene.pack(x)], carry)


# -- processes -------------------------------------------------------------------------------------
def environment(without=("PYTEST_",), **variables):
    """Of a process that is no worker of the tests'."""
    own = {name: value for name, value in os.environ.items() if not name.startswith(tuple(without))}
    return own | {name: str(value) for name, value in variables.items()}


def run(*command, **variables):
    given = {"cwd": REPOSITORY, "env": environment(**variables), "timeout": 240}
    return subprocess.run(list(map(str, command)), capture_output=True, text=True, **given)


#: plug-ins of pytest that the environment of the benchmark does not have
FOREIGN = [part for name in ("hypothesispytest", "jaxtyping", "anyio") for part in ("-p", f"no:{name}")]


def bench(results, keyword, *more):
    """A smoke run of the experiments in a process of its own."""
    command = [sys.executable, "-m", "pytest", "bench", "--profile", "smoke", "--results", str(results), "-q"]
    return start([*command, "-p", "no:cacheprovider", *FOREIGN, "-k", keyword, *more])


def own_processes(results, keyword, *more):
    """The same by the command line, which has processes of its own."""
    command = [sys.executable, "-m", "contactbench", "bench", "--all", "--profile", "smoke", "-k", keyword]
    return start([*command, "--results", str(results), *more])


def start(command):
    both = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
    return subprocess.Popen(command, cwd=REPOSITORY, env=environment(JAX_PLATFORMS="cpu"), **both)


def finished(process):
    """Its output, once it has ended well."""
    output, _ = process.communicate(timeout=240)
    assert process.returncode == 0, output
    return output


class Ticks:
    """A clock that every look moves."""

    def __init__(self, tick: float = 1.0) -> None:
        self.now, self.tick = 0.0, tick

    def __call__(self) -> float:
        self.now += self.tick
        return self.now


class Clock:
    """The processor's time of the tests alone, however busy the machine is, and what a test adds to it."""

    added = 0.0
    #: which Windows tells in ticks of a sixtieth of a second
    passed = staticmethod(time.perf_counter if sys.platform == "win32" else time.process_time)

    def __call__(self):
        return self.passed() + self.added


def readers():
    """Import all of contactbench that reads a clock, lest a module that is loaded later read another one."""
    for path in Path(cb.__file__).parent.rglob("*.py"):
        if "import perf_counter" in path.read_text(encoding="utf-8"):
            parts = path.relative_to(Path(cb.__file__).parents[1]).with_suffix("").parts
            yield import_module(".".join(parts))


READERS = [*readers()]


@contextmanager
def reading(clock):
    """Have all of contactbench read another clock."""
    with pytest.MonkeyPatch.context() as patch:
        for module in READERS:
            patch.setattr(module, "perf_counter", clock)
        yield clock


# -- γ(t) without a closed form of its integral, and one that changes its sign -------------------------------
FORCED_PULSATING = mine(
    lambda q, t, omega, force, drive, **rest: omega**2 * q[0] ** 2 / 2 - force * q[0] * xm.cos(drive * t),
    t_end=20.0,
    kind=cb.Driven,
    name="forced_pulsating",
    gradient=lambda q, t, omega, force, drive, **rest: (omega**2 * q[0] - force * xm.cos(drive * t),),
    rate=lambda t, friction, depth, pulse, **rest: friction * (1 + depth * xm.sin(pulse * t)),
    parameters={**FORCED_OSCILLATOR.parameters, "friction": 0.1, "depth": 1.5, "pulse": 1.3},
)
#: all of them, the potentials only hard ones have, and the shapes the registry does not have
ALL_SCENES = [*STANDARD, TWO_SCALES, *map(cb.SCENES.get, ("kepler_drag", "double_pendulum", "thermostat"))]
ALL_SCENES += [FORCED_PULSATING, USER, TILTED]
#: without parameters, a force and a damping that depend on time
PULSATING = mine(
    lambda q, t: q[0] ** 2 / 2 - 0.3 * q[0] * xm.sin(0.7 * t),
    t_end=20.0,
    kind=cb.Driven,
    name="pulsating",
    rate=lambda t: 0.1 * (1 + 1.5 * xm.sin(1.3 * t)),
)


# -- Lane–Emden of index 1, in closed form, and a problem whose end is printed ----------------------------------
def spreading_wave(scene, t, mp):
    """Return u/t, u'' = −u, the motion under γ = 2/t; s − ½ q p falls as 1/t², the potential being quadratic."""
    t0, now = scene.t, scene.t + t
    u0, w0 = t0 * scene.q[0], t0 * scene.p[0] + scene.q[0]
    sin, cos = xm.sin(t), xm.cos(t)
    u, w = u0 * cos + w0 * sin, w0 * cos - u0 * sin
    q, p = u / now, (w - u / now) / now
    rest = (t0 / now) ** 2 * (scene.s - scene.q[0] * scene.p[0] / 2)
    return DrivenState((q,), (p,), now, q * p / 2 + rest)


OWN = {"rate": spherical, "span": spherical_span, "exact": spreading_wave, "t": 1.0}
START = {"q": 0.8414709848078965, "p": -0.30116867893975674, "t_end": 20.0}
LANE_EMDEN_1 = mine(lambda q, t: q[0] ** 2 / 2, kind=cb.Driven, name="lane_emden_1", **START, **OWN)
#: problem E3 of DETEST: Hull, Enright, Fellen, Sedgwick, SIAM J. Numer. Anal. 9, 603 (1972), doi:10.1137/0709052
DETEST_E3 = mine(
    lambda q, t, softness, force, drive: (
        q[0] ** 2 / 2 - q[0] ** 4 / (4 * softness) - force * q[0] * xm.sin(drive * t)
    ),
    q=0.0,
    t_end=20.0,
    kind=cb.Driven,
    name="detest_e3",
    parameters={"softness": 6.0, "force": 2.0, "drive": 2.78535},
)


# -- a pole that is passed closely, and numbers that underflow ------
#: 4° from the upright pole, slowly turning: it swings back up to near the pole time and again
UPRIGHT_PENDULUM = cb.SCENES["spherical_pendulum"].with_(
    name="upright_pendulum", gamma=1e-3, q=(0.07584, 0.0, 0.99712), p=(0.0, 0.1, 0.0), t_end=50.0
)

#: e^{−γT} = e^{−1000}: momentum and energy fall below the smallest number there is, the attitude stays of size one
UNDERFLOW = cb.SCENES["rigid_body"].with_(name="underflow", gamma=5.0, t_end=200.0)

#: those with time in them
TIMED = (FORCED_PULSATING, LANE_EMDEN_1, DETEST_E3)


def scene_of(name):
    """Return a scene by its name, one of these or a registered one."""
    own = {scene.name: scene for scene in TIMED}
    return own.get(name) or cb.SCENES[name]


# -- scenes of several bodies ------------------------------------------------------------------------
def onsite(q):
    return q * q / 4 + cb.math.cos(q)


def bond(r, k):
    return k * r * r / 2 + r * r * r / 8 + r * r * r * r / 16


def chain_potential(boundary, onsite, bond):
    """Return V(q, **parameters) of a chain whose sites are held by `onsite` (or None) and bound by `bond`."""

    def potential(q, **parameters):
        ends = {"ring": (*q, q[0]), "fixed": (0.0, *q, 0.0), "free": q}[boundary]
        total = sum(bond(b - a, **parameters) for a, b in pairwise(ends))
        return total if onsite is None else total + sum(map(onsite, q))

    return potential


def body_potential(pair, masses, dimensions):
    """Return V(q, **parameters), the sum of pair(r², m_a, m_b) over all pairs of bodies."""

    def potential(q, **parameters):
        places = [q[dimensions * k : dimensions * (k + 1)] for k in range(len(masses))]
        total = 0.0
        for (x, a), (y, b) in combinations(zip(places, masses, strict=True), 2):
            total = total + pair(
                sum((c - d) * (c - d) for c, d in zip(x, y, strict=True)), a, b, **parameters
            )
        return total

    return potential


def data(size, seed=1):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (2, size))


def masses(n, seed=2):
    return tuple(np.random.default_rng(seed).uniform(0.5, 2.0, n).tolist())


def chain(n, boundary="ring", held=True, mass=1.3, bond=bond, **changes):
    """A chain of n sites; held : by a potential at each of them."""
    q, p = map(tuple, data(n).tolist())
    potential = chain_potential(boundary, onsite if held else None, bond)
    given = {"parameters": {"k": 1.5}, "q": q, "p": p, "s": 0.3, "mass": mass, "gamma": 0.2, "t_end": 1.0}
    return cb.Mechanical(name=f"chain-{boundary}", potential=potential, **given | changes)


def softened(r2, a, b, soft):
    return -a * b / cb.math.sqrt(r2 + soft)


def bodies(n, dimensions, pair=softened, **changes):
    q, p = data(n * dimensions)
    own = masses(n)
    given = {"parameters": {"soft": 0.25}, "q": tuple((4 * q).tolist()), "p": tuple(p.tolist()), "s": 0.3}
    given |= {"mass": tuple(np.repeat(own, dimensions).tolist()), "gamma": 0.2, "t_end": 1.0}
    return cb.Mechanical(name="bodies", potential=body_potential(pair, own, dimensions), **given | changes)


def planets(masses, q, p, softening, **given):
    """Bodies of given masses in a plane."""
    more = {"gamma": 0.0, "parameters": {"soft": softening**2}, "mass": tuple(np.repeat(masses, 2))} | given
    return cb.Mechanical(name="planets", potential=body_potential(softened, masses, 2), q=q, p=p, **more)


#: Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.10: mass times velocity for p
PLEIADES = planets(
    np.arange(1.0, 8.0),
    (3.0, 3.0, 3.0, -3.0, -1.0, 2.0, -3.0, 0.0, 2.0, 0.0, -2.0, -4.0, 2.0, 4.0),
    (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -5.0, 0.0, 5.0, 10.5, 0.0, -10.5, 0.0),
    0.0,
    t_end=3.0,
)

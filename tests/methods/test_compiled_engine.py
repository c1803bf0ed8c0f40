"""Recorded numbers, recorded programs, and the compiled loops made of them."""

import ctypes
import itertools
import math
import os
import shutil
import stat
import sys

import numpy as np
import pytest

import contactbench as cb
from cases import ALL_SCENES, FIXED, REPOSITORY, TILTED, pairs, random_state, run
from contactbench.measure import isolation
from contactbench.methods.loops import loop_of
from contactbench.numbers.control import repeat
from contactbench.numbers.protocol import CannotRecord
from contactbench.peers.base import record_function
from contactbench.solution import Status
from contactbench.trace import compiled, kept
from contactbench.trace.compiled import compile_function
from contactbench.trace.form import FUNCTIONS, execute
from contactbench.trace.kept import read_kept, write_kept
from contactbench.trace.program import record
from contactbench.trace.recording import ALIASES

PARTICLE = cb.SCENES["particle"]


# -- sources ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("what", "scene"),
    [(what, s) for s in ALL_SCENES for what in ("rhs", "jacobian")[: 1 + s.has_jacobian]],
    ids=lambda item: getattr(item, "name", item),
)
def test_source_computes_what_the_scene_does(scene, what):
    """To the last bit: the operations are the same, in the same order."""
    for carry in {scene.carry(()), scene.carry()}:
        x = random_state(scene, carry=carry)
        result = getattr(scene, what)(x)
        expected = scene.without_clock(scene.pack(result)) if what == "rhs" else result
        function, time = record_function(scene, what, carry), x.t if scene.clock else 0.0
        np.testing.assert_array_equal(function(time, scene.without_clock(scene.pack(x))), expected)


# -- programs --------------------------------------------------------------------------------------
#: arguments at which every function is defined
INSIDE = 0.3


def every_operation(numbers, h, n, y, xp, repeat):
    """One result for every function and operator."""
    x, big = y[0], 1 / y[0]
    names = [name for name in (*FUNCTIONS, *ALIASES) if name not in ("arccosh", "arctan2")]
    results = [getattr(xp, name)(big if name == "acosh" else x) for name in names]
    results += [xp.arccosh(big), xp.atan2(x, -big), xp.arctan2(x, big), xp.hypot(x, big)]
    results += [x**k for k in (-3, -1.5, -0.5, 0.5, 1, 2, 2.5, 7, 0.3)] + [2.0**x, abs(-x), -x, +x]
    results += [1 - x, x - 1, 2 / x, x / 2, x * big - 0 * x, np.sin(x), np.float64(3) * x, np.square(x)]
    condition = (x < 1) & ~(x >= big) | (x == 7)
    results += [xp.where(condition, x, big), xp.where(x != x, 0.0, 1.0), xp.where(True, x, big)]
    results += [xp.maximum(x, big), xp.minimum(x, 0.1), xp.where((x <= 0.3) & (x > 0.2), 1.0, 0.0)]
    results += [repeat(n, lambda v: v * h + numbers[0], x)]
    results += [repeat(3, lambda v: (v[0] + v[1], v[1] + 1), (x, 0))[0]]
    column = xp.multiply.outer(xp.asarray([1.0, 2.0, 5.0]), h)
    summed = repeat(3, lambda v: (v[0] + xp.exp(column)[v[1]], v[1] + 1), (x, 0))[0]
    return [*results, summed, column[-1] * x, column[xp.asarray([2, 1])][1] * x]


class Plain:
    """The same namespace for floats."""

    inf, asarray, where = math.inf, staticmethod(np.asarray), staticmethod(lambda c, a, b: a if c else b)
    maximum, minimum, multiply = max, min, np.multiply

    def __getattr__(self, name):
        return np.exp if name == "exp" else getattr(math, ALIASES.get(name, name))


def test_every_operation_is_compiled_to_what_it_is():
    numbers, h, n = [0.7], 0.25, 4
    truth = every_operation(numbers, h, n, [np.float64(INSIDE)], Plain(), repeat)
    d = len(truth)
    program = record(every_operation, 1, d, 1, 1e6)
    w, y = np.empty((1, program.width)), np.empty(d)
    start, shape = np.full(d, INSIDE), np.append(program.shape, 0)
    for back_end in (compile_function, execute):
        setup, run = back_end(program.setup), back_end(program.run)
        y[:] = math.nan
        setup(np.array(numbers), np.array([[h, n]]), program.data, program.shape, w)
        assert run(start, w, shape, y) == -1
        np.testing.assert_allclose(y, np.array(truth, dtype=float), rtol=4e-16, atol=0)


# -- the engine ------------------------------------------------------------------------------------
@pairs(FIXED, ALL_SCENES, lambda method, scene: method.refuses(scene) is None)
@pytest.mark.quick(scene="particle", method=("contact-rkn8", "contact-gauss2", "herglotz2", "rk4"))
@pytest.mark.quick(method="contact-abc")
def test_the_loop_is_the_same_map_compiled_and_in_python(method, scene):
    """As the step map is written, to round-off: uneven saved times, every field carried or none.

    Where a step of 0.06 is too long for a hard scene, both end alike.
    """
    for carry in {scene.carry(()), scene.carry()}:
        options = {"step": 0.06, "save_at": [0.5, 0.75, 2.0], "carry": carry, "dense": False}
        run, plain = (cb.prepare(scene, method.name, engine=e, **options) for e in ("llvm", "python"))
        if not (end := plain()).ok:
            assert scene.name in ("kepler_drag", "thermostat")
            assert run().status is end.status
            continue
        written = plain.loop.as_written(plain.start, plain.ready)
        written = np.array(written)[:, : len(plain.start)]
        assert plain.loop.program is not None
        for solution in run(), plain():
            counts = plain.totals
            if method.iterates:
                counts = counts._replace(evaluations=solution.counts.evaluations)
            assert (solution.status, solution.counts) == (Status.ok, counts)
            # large coefficients of both signs; and next to the centre of force the motion makes more of it
            round_off = 2e-14 if method.one_step and scene.name != "kepler_drag" else 2e-13
            np.testing.assert_allclose(solution.y, written, rtol=0, atol=round_off * np.abs(written).max())


def test_what_python_cannot_compute_ahead_is_compiled():
    """exp(800) is infinite to a processor, an error to Python."""
    scene = cb.SCENES["antidamping"].with_(gamma=-20.0)
    loop = loop_of(cb.METHODS["contact-strang"], scene, ())
    vars(loop).pop("setup", None)
    rows = loop.table(np.array(scene.numbers()), np.array([[80.0, 1.0]]))
    assert "setup" in vars(loop)
    assert np.isinf(rows).any()


def test_very_many_different_steps_are_taken_in_parts(monkeypatch):
    options = {"step": 0.03, "save_at": np.cumsum(np.random.default_rng(1).uniform(0.01, 0.1, 100))}
    whole = cb.solve(PARTICLE, "contact-bm6", **options).y
    monkeypatch.setattr("contactbench.methods.loops.AHEAD", 2000)
    np.testing.assert_array_equal(cb.solve(PARTICLE, "contact-bm6", **options).y, whole)


# -- what cannot be recorded -----------------------------------------------------------------------
UNKNOWN = {
    "math.sin": lambda x: math.sin(x),
    "index": lambda x: [1, 2, 3][x],
    "max": lambda x: max(x, 0.0),
    "array": lambda x: np.array([x]) * 2,
    "'text'": lambda x: x + "text",
}


@pytest.mark.parametrize("name", UNKNOWN)
def test_what_cannot_be_recorded_is_named(name):
    with pytest.raises(CannotRecord, match=name):
        record(lambda numbers, h, n, y, xp, repeat: [UNKNOWN[name](y[0])], 1, 1, 1, 1e6)


# -- the cache -------------------------------------------------------------------------------------
RUN = """
import contactbench as cb, sys
run = cb.prepare("central", "contact-rkn4", step=0.1)
from contactbench.trace.compiled import machine
print(machine().compiled, run().y[-1].tolist())
assert "numba" not in sys.modules, "it takes as long to import as all else"
"""


def run_elsewhere(folder, source=RUN):
    done = run(sys.executable, "-c", source, CONTACTBENCH_CACHE=folder, PYTHONPATH=REPOSITORY / "src")
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout.split(" ", 1)


def test_a_second_process_compiles_nothing(tmp_path):
    compiled, states = run_elsewhere(tmp_path)
    (path,) = (tmp_path / "programs").iterdir()
    before = path.stat().st_mtime_ns
    assert (compiled, path.suffix) == ("1", ".object")
    assert run_elsewhere(tmp_path) == ["0", states]
    assert [*(tmp_path / "programs").iterdir()] == [path]
    assert path.stat().st_mtime_ns == before


def compiled_anew():
    """Whether a machine as that of a new process compiles a program, or finds it kept; what it computes is right."""
    made = compiled.Machine()
    address = made.address("key", "i64", ("i64",), lambda builder, x: builder.add(x[0], x[0].type(41)))
    assert ctypes.CFUNCTYPE(ctypes.c_int64, ctypes.c_int64)(address)(1) == 42
    return bool(made.compiled)


@pytest.fixture
def cache(tmp_path, monkeypatch):
    """The folder of a cache in which nothing is kept yet."""
    monkeypatch.setenv("CONTACTBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(kept, "folder", kept.folder.__wrapped__)
    return tmp_path / "cache"


@pytest.fixture
def path(cache):
    """The file of the one program that it keeps."""
    assert compiled_anew()
    assert not compiled_anew()
    (path,) = (cache / "programs").iterdir()
    return path


def flip(content):
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


DAMAGE = (lambda whole: b"\x9c" * len(whole), lambda whole: whole[: len(whole) // 2], lambda whole: b"", flip)


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_program_is_compiled_anew_and_replaced(damage, path):
    path.write_bytes(damage(path.read_bytes()))
    assert read_kept(path) is None
    assert compiled_anew()
    assert read_kept(path)
    assert not compiled_anew()


def fill(path):
    (path / "in the way").mkdir(parents=True)


FIFO = pytest.param(getattr(os, "mkfifo", None), marks=pytest.mark.posix)


@pytest.mark.parametrize("put", [fill, FIFO])
def test_what_can_neither_be_read_nor_replaced_is_left_alone(put, path):
    path.unlink()
    put(path)
    assert compiled_anew()
    assert [*path.parent.iterdir()] == [path]
    assert not path.is_file()


def test_a_folder_that_cannot_be_written_to_is_no_obstacle_and_none_is_left_elsewhere(cache, monkeypatch):
    cache.write_text("")
    (elsewhere := cache.with_name("temporary")).mkdir()
    monkeypatch.setenv("TMPDIR", str(elsewhere))
    assert compiled_anew()
    assert not [*elsewhere.iterdir()]


# -- whose it is: compiled code is run, so that nobody else may have put it there --------------------
OTHERS = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files belong to nobody here")


@OTHERS
@pytest.mark.parametrize("mode", [0o777, 0o1777])
def test_nothing_is_kept_in_a_folder_of_everybody(mode, cache, monkeypatch):
    """Neither of ours nor of XLA; a folder of our own is the user's alone."""
    for kind in ("programs", "xla"):
        assert stat.S_IMODE(kept.folder(kind).stat().st_mode) == stat.S_IMODE(cache.stat().st_mode) == 0o700
    cache.chmod(mode)
    assert [kept.folder(kind) for kind in ("programs", "xla")] == [None, None]
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    monkeypatch.setattr(isolation, "folder", kept.folder)
    monkeypatch.setattr(os, "environ", dict(os.environ))
    isolation.settle()
    assert "JAX_COMPILATION_CACHE_DIR" not in os.environ


@OTHERS
@pytest.mark.parametrize(
    ("whose", "mode"), [("folder", 0o777), ("folder", 0o770), ("file", 0o622), ("file", 0o664)]
)
def test_what_others_may_write_to_is_not_run(whose, mode, path):
    """A folder is left alone, a program compiled anew."""
    (path if whose == "file" else path.parent).chmod(mode)
    before = path.stat().st_mtime_ns
    assert whose == "folder" or read_kept(path) is None
    assert compiled_anew()
    assert [*path.parent.iterdir()] == [path]
    assert read_kept(path) if whose == "file" else path.stat().st_mtime_ns == before


@OTHERS
def test_a_program_of_another_user_or_of_another_name_is_not_loaded(path, monkeypatch):
    """A name is a digest of the program, the versions and the processor."""
    shutil.copy(path, other := path.with_name("program_of_another_processor.object"))
    assert read_kept(other) is None
    write_kept(other, read_kept(path))
    assert read_kept(other) == read_kept(path)
    user = path.stat().st_uid + 1
    monkeypatch.setattr(os, "getuid", lambda: user)
    assert read_kept(path) is None


# -- calls from Python -----------------------------------------------------------------------------
def arguments_of(run):
    w, shape = run.ready[3]
    return run.start, w, shape, np.empty(len(run.n) * len(run.start))


def frozen(array):
    array = array.copy()
    array.flags.writeable = False
    return array


#: what an argument is replaced by, and which
BAD = {
    "list": (0, lambda x: x.tolist()),
    "dimensions of a table": (1, lambda x: x[0]),
    "whole numbers": (0, lambda x: x.astype(np.int64)),
    "single precision": (0, lambda x: x.astype(np.float32)),
    "not contiguous": (0, lambda x: np.repeat(x, 2)[::2]),
    "read-only": (3, frozen),
}


@pytest.mark.parametrize("name", BAD)
def test_what_a_program_does_not_take_is_refused(name):
    run = cb.prepare("oscillator", "contact-strang", step=0.5, carry=())
    given, (which, change) = [*arguments_of(run)], BAD[name]
    assert run.loop.loop.run(*given) == -1
    wrong = [change(x) if i == which else x for i, x in enumerate(given)]
    for arguments in (wrong, given[:3], given + given[:1]):
        with pytest.raises(TypeError):
            run.loop.loop.run(*arguments)


CALLED = [
    ("oscillator", "contact-strang", {"step": 0.5}),
    ("oscillator", "rk8-7", {"rtol": 1e-6, "dense": False}),
]
CALLED += [("rigid_body", "contact-exact", {})]


@pytest.mark.parametrize(("scene", "method", "options"), CALLED)
def test_a_bare_call_takes_any_start_of_its_size_and_leaves_it_alone(scene, method, options):
    """Strided and read-only ones too; of other sizes and types none."""
    run = cb.prepare(scene, method, **options)
    end, start = run.bare(run.start), run.start.copy()
    for same in (np.repeat(start, 2)[::2], frozen(start)):
        np.testing.assert_array_equal(run.bare(same), end)
        np.testing.assert_array_equal(same, start)
    others = start[:-1], np.append(start, 0.0), start.astype(np.float32), start.astype(int), start[None]
    for other in others:
        with pytest.raises(TypeError):
            run.bare(other)


@pytest.mark.parametrize("small", [True, False])
def test_what_a_call_returns_is_not_changed_by_the_next(small, monkeypatch):
    monkeypatch.setattr("contactbench.trace.native_call.SMALL", 10**4 if small else 0)
    run = cb.prepare("oscillator", "contact-strang", step=0.03 + small / 1e3, carry=())
    first, whole = run.bare(run.start), run()
    copies = first.copy(), whole.y.copy()
    run.bare(2 * run.start), run(q=(0.7,))
    np.testing.assert_array_equal(first, copies[0])
    np.testing.assert_array_equal(whole.y, copies[1])


TOGETHER = """
import sys
from concurrent.futures import ThreadPoolExecutor
import contactbench as cb
sys.setswitchinterval(1e-6)
names = ["contact-strang", "contact-rkn4", "rk4", "contact-rkn6"] * 3
with ThreadPoolExecutor(4) as pool:
    found = list(pool.map(lambda name: cb.solve("oscillator", name, step=0.1).y[-1, 0], names))
assert found[:4] * 3 == found, found
"""


def test_threads_that_compile_first_share_what_they_compile(tmp_path):
    run_elsewhere(tmp_path, TOGETHER)


# -- scenes that differ in one thing a program depends on --------------------------------------------
def quartic(q, a=1.0, b=0.5):
    return sum(a * c * c / 2 + b * c * c * c * c / 4 for c in q)


def force(q, a=1.0, b=0.5):
    return tuple(a * c + b * c * c * c for c in q)


START = {"q": (0.8,), "p": (0.3,), "s": 0.4, "t_end": 2.0}
FORCE = {"potential": quartic, "gradient": force}
SHAKEN = {
    "potential": lambda q, t: quartic(q) - 0.3 * q[0] * cb.math.cos(t),
    "gradient": lambda q, t: (force(q)[0] - 0.3 * cb.math.cos(t),),
}


RATES = (lambda t: 0.2 + 0.1 * cb.math.sin(t)), (lambda t: 0.3 - 0.1 * cb.math.cos(t))
DAMPINGS = [(lambda s: 0.2 * s, lambda s: 0.2), (lambda s: 0.2 * s + s * s * s, lambda s: 0.2 + 3 * s * s)]


def driven(rate):
    return cb.Driven(name="driven", **SHAKEN, rate=rate, **START)


def damped(damping, slope):
    return cb.GeneralDamping(name="damped", **FORCE, damping=damping, damping_slope=slope, **START)


SPUN = {"inertia": (1.0, 1.7, 2.1), "M": (0.8, 0.9, -0.5), "s": 0.2}
BODY = cb.SCENES["rigid_body"].with_(gamma=0.25, t_end=2.0, **SPUN)
AXES = (0.1, 0.2, 0.3)
STIFFER = {"potential": lambda q: sum(c * c for c in q), "gradient": lambda q: tuple(2 * c for c in q)}
WELL = cb.Mechanical(name="well", **FORCE, gamma=0.2, **START)
SPRING = cb.SCENES["stiff_spring"].with_(t_end=2.0)
#: what differs: two scenes or more, and the fields each is to carry
PAIRS = {
    "order of the inertias": [
        (BODY.with_(inertia=i), None) for i in ((1.0, 1.7, 2.1), (2.1, 1.0, 1.7), (1.7, 2.1, 1.0))
    ],
    "kind of damping": [(BODY, None), *((BODY.with_(damping=d), None) for d in (AXES, TILTED.damping))],
    "fields of a body": [(BODY, ()), (BODY, ("s",)), (BODY, ("R",)), (BODY, ("R", "s"))],
    "sign of kappa": [(WELL.with_(kappa=k), None) for k in (0.0, 0.3, -0.2)],
    "fields": [(WELL, ()), (WELL, ("s",))],
    "numbers": [(WELL, None), (WELL.with_(gamma=0.5), None)],
    "names of parameters": [
        (WELL.with_(parameters=p), None) for p in ({}, {"a": 1.5, "b": 0.2}, {"b": 0.2, "a": 1.5}, {"b": 0.2})
    ],
    "components": [(WELL.with_(q=q, p=q[::-1]), None) for q in ((0.8,), (0.8, 0.5), (0.8, 0.5, 0.3))],
    "potential": [(WELL, None), (WELL.with_(**STIFFER), None)],
    # functions of the package are not recorded: the rest of the key is to tell these apart
    "names of our parameters": [
        (SPRING.with_(parameters=p), None)
        for p in ({"omega": 3.0, "coupling": 0.4}, {"coupling": 0.4, "omega": 3.0})
    ],
    "our potential": [(cb.SCENES[name].with_(t_end=2.0), None) for name in ("particle", "central")],
    "rate": [(driven(rate), None) for rate in RATES],
    "damping": [(damped(*damping), None) for damping in DAMPINGS],
}
ENGINES = {"contact-strang": "llvm", "contact-exact": "llvm", "cvode-bdf": "c", "cyrk-dop853": "c++"}
ENGINES |= {"heyoka-taylor": "llvm", "diffrax-tsit5": "jax"}


def last_state(scene, carry, name, engine):
    method, options = cb.METHODS[name], {"engine": engine, "carry": carry, "save_at": [scene.t_end]}
    setting = {} if method.exact else {"rtol": 1e-9} if method.adaptive else {"step": 0.1}
    return cb.solve(scene, name, **options, **setting).y[-1]


@pytest.mark.parametrize("order", ["forwards", "backwards"])
@pytest.mark.parametrize("what", PAIRS)
@pytest.mark.quick(order="forwards")
def test_no_scene_gets_the_program_of_another(what, order, fresh):
    """Compiled, whichever of them is solved first, against Python, which knows of no other scene."""
    cases, ends = [], []
    for scene, carry in PAIRS[what][:: 1 if order == "forwards" else -1]:
        fresh()
        ends.append(last_state(scene, carry, "scipy-dop853", "python"))
        for name, engine in ENGINES.items():
            if cb.METHODS[name].refuses(scene) or (engine == "jax" and what != "fields"):  # XLA takes seconds
                continue
            own = "python" in cb.METHODS[name].engines
            alone = last_state(scene, carry, name, "python") if own else ends[-1]
            cases.append((scene, carry, name, engine, alone, 1e-12 if own else 1e-6))
    fresh()
    for *case, alone, off in cases:
        np.testing.assert_allclose(last_state(*case), alone, rtol=0, atol=off, err_msg=str(case[2:]))
    for a, b in itertools.combinations(ends, 2):  # names in two orders: one motion
        assert "names" in what or len(a) != len(b) or np.abs(a - b).max() > 1e-3, "one is seen for the other"

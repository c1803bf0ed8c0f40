"""Every Python block of README and documentation runs, page by page; limits that pages quote are those of the code."""

import os
import re
import socket
import subprocess
import sys
from functools import partial
from pathlib import Path
from shutil import copy

import numpy as np
import pytest

import contactbench as cb
from cases import REPOSITORY, few_slow
from contactbench.gate import compare, speed
from contactbench.measure import clock, law, statistics
from contactbench.runs import timetable
from contactbench.runs.problems import FAMILIES
from contactbench.study.compare import BUDGET
from contactbench.tables import declared
from contactbench.testing import check_method
from contactbench.testing.method import CASES
from contactbench.truth import survey
from made_up import folder

BLOCK = re.compile(r"^```python[^\n]*\n(.*?)^```", re.DOTALL | re.MULTILINE)
PAGES = [
    path
    for path in (REPOSITORY / "README.md", *sorted((REPOSITORY / "docs").glob("*.md")))
    if BLOCK.search(path.read_text()) and path.name != "trajectories.md"  # which is below
]
#: seconds of a race whose page does not say how long it may take
SECONDS = 2.0
#: take ten seconds
LONG = [page for page in PAGES if page.name in ("adding.md", "embed.md", "gallery.md", "tutorial.md")]


@pytest.mark.parametrize("page", few_slow(PAGES, *LONG), ids=lambda path: path.name)
def test_the_code_of_a_page_runs(page, registries, unconfirmed, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    made = folder(tmp_path / "tables")  # a clone's may be those of any run
    for table in (REPOSITORY / "results").glob("population*.csv"):  # those that lead are found in it
        copy(table, made)
    monkeypatch.setattr(declared, "shipped_folder", lambda: made)
    monkeypatch.setattr(cb, "compare", partial(cb.compare, budget=SECONDS))
    text, scope, known = page.read_text(), {}, {*cb.METHODS}
    for block in BLOCK.finditer(text):
        # padded so that a traceback shows the page's own line
        before = "\n" * text.count("\n", 0, block.start(1))
        exec(compile(before + block[1], str(page), "exec"), scope)
    for name in {*cb.METHODS} - known:
        assert check_method(cb.METHODS[name], engines=cb.METHODS[name].engines[:1], scenes=CASES[:1])


# -- limits that the documentation quotes ------------------------------------------------------------
#: the shortest pulse that is seen, in parts of the span
PULSE = f"about {({2: 'two'})[round(1e6 / survey.SAMPLES)]} millionths of the"
DOCS = Path(__file__).parents[2] / "docs"
QUOTED = {
    "adding.md": [PULSE],
    "compare.md": [
        f"budget ({BUDGET:.0f} s by default)",
        f"{clock.VISITS} times or more",
        f"wider than {statistics.WIDEST - 1:.0%}",
    ],
    "gate.md": [
        f"by a factor of {compare.ERROR_FACTOR:.0f}",
        f"by {compare.VALUE_CHANGE:.0%}",
        f"above {speed.RATIO_LIMIT}",
        f"at most {1e3 * speed.LONGEST_CALL:.0f} ms",
    ],
    "reading.md": [
        PULSE,
        f"more than {law.WRECKED:.0%}",
        f"no larger error {clock.VISITS} times",
        f"{clock.ROUNDS} rounds of at least {1e3 * clock.ROUND_SECONDS} ms",
        f"more than {1e3 * clock.LONG:.0f} ms",
        *(f"more than {1e3 * seconds:.0f} ms" for seconds in timetable.SPARED),
        f"a factor of {timetable.NEAR:g} of the least",
        f"the others {timetable.OTHERS} times",
        f"{statistics.WIDEST - 1:.0%} at least",
        f"wider than {statistics.WIDEST - 1:.0%}",
    ],
}


@pytest.mark.parametrize("page", QUOTED)
def test_quoted_limits_are_those_of_the_code(page):
    text = (DOCS / page).read_text().replace(" %", "%")
    assert [quote for quote in QUOTED[page] if quote not in text] == []


def test_every_family_of_the_population_has_one_start():
    starts = (DOCS.parent / "CONTRIBUTING.md").read_text().split("| start | families |")[1].split("\n\n")[0]
    assert sorted(starts.split("`")[1::2]) == sorted(FAMILIES)


# -- the code of docs/trajectories.md ----------------------------------------------------------------
PAGE = (REPOSITORY / "docs" / "trajectories.md").read_text(encoding="utf-8")
ONE, SAVED, DIVIDED = re.findall(r"^```python[^\n]*\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
STEPS = 100
#: a few roundings a step, of states of size 1
ROUND_OFF = 4 * np.finfo(float).eps * STEPS
#: seconds that two processes have, imports included
LIMIT = 300
#: what a process writes of the third block's variables
WRITE = """
import sys
np.savez(sys.argv[1], start=start, gamma=gamma, own=own, mean=mean, devices=mesh.size)
"""


def state_at(times, start, gamma):
    """Return the states (d, n) of every trajectory at the last time, or (n, times, d) at each of several."""
    made = []
    for q1, q2, p1, p2, rate in zip(*start, gamma, strict=True):
        scene = cb.SCENES["particle"].with_(q=(q1, q2), p=(p1, p2), gamma=rate)
        made.append(cb.prepare(scene, "contact-rkn4", step=0.1, carry=(), save_at=times)().y)
    return np.array(made) if len(times) > 1 else np.array(made)[:, 0].T


def variables(block):
    """Return the variables of a block that runs by itself."""
    made = {}
    exec(compile(block, "trajectories.md", "exec"), made)
    return made


def test_mapped_trajectories_are_those_of_single_runs():
    made = variables(ONE)
    expected = state_at([10.0], made["start"], made["gamma"])
    for found in (made["ends"], made["same"]):
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUND_OFF)
    shift = 1e-5
    ahead, behind = (state_at([10.0], made["start"], made["gamma"] + s)[0] for s in (shift, -shift))
    # differences are off by 10⁻¹⁰ of a third derivative, and by round-off over 10⁻⁵
    np.testing.assert_allclose(made["slopes"], (ahead - behind) / (2 * shift), rtol=0, atol=1e-7)


def test_saved_states_are_those_of_single_runs():
    made = variables(SAVED)
    times = [0.1 * k for k in range(10, STEPS + 1, 10)]
    expected = state_at(times, made["start"], [cb.SCENES["particle"].gamma] * made["n"])
    np.testing.assert_allclose(made["paths"], expected, rtol=0, atol=ROUND_OFF)


def processes(folder, count, devices):
    """Run the third block in so many processes on this host; return what each has written."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    given = {name: value for name, value in os.environ.items() if not name.lower().endswith("_proxy")}
    given |= {"COORDINATOR": f"127.0.0.1:{port}", "HOSTS": str(count), "JAX_PLATFORMS": "cpu"}
    given |= {"JAX_CPU_COLLECTIVES_IMPLEMENTATION": "gloo", "JAX_NUM_CPU_DEVICES": str(devices)}
    program, paths = folder / "trajectories.py", [folder / f"{host}.npz" for host in range(count)]
    program.write_text(DIVIDED + WRITE, encoding="utf-8")
    started = [
        subprocess.Popen([sys.executable, program, path], env=given | {"HOST": str(host)})
        for host, path in enumerate(paths)
    ]
    try:
        assert [process.wait(LIMIT) for process in started] == [0] * count
    finally:
        for process in started:  # one that fails leaves the other waiting for it
            process.kill()
            process.wait()
    return [np.load(path) for path in paths]


@pytest.mark.timeout(LIMIT + 30)
def test_trajectories_divided_among_two_processes_are_those_of_single_runs(tmp_path):
    shares = processes(tmp_path, 2, 2)
    assert [int(share["devices"]) for share in shares] == [4, 4]
    assert not np.array_equal(shares[0]["gamma"], shares[1]["gamma"])
    found = np.hstack([share["own"] for share in shares])
    for share in shares:
        expected = state_at([10.0], share["start"], share["gamma"])
        np.testing.assert_allclose(share["own"], expected, rtol=0, atol=ROUND_OFF)
        assert float(share["mean"]) == pytest.approx(found[0].mean(), abs=1e-14)

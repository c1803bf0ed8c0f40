"""What a notebook shows, what is drawn, and the refusals that name the nearest way."""

from __future__ import annotations

import numpy as np
import pytest

import contactbench as cb

ONE = {"name": "one", "q": (1.0,), "p": (0.0,), "t_end": 1.0}


@pytest.mark.parametrize("scene", ["particle", "rigid_body", "forced_pulsating", "quadratic_damping"])
def test_a_solution_is_drawn(scene):
    from matplotlib import pyplot

    solution = cb.solve(scene, "contact-strang", step=0.1)
    figure = solution.plot()
    motion, portrait, energies = figure.axes
    first = solution.M if solution.q is None else solution.q
    np.testing.assert_array_equal(motion.lines[0].get_ydata(), first[:, 0])
    np.testing.assert_array_equal(portrait.lines[0].get_xdata(), first[:, 0])
    assert energies.lines[0].get_label() == "H0"
    pyplot.close(figure)


def test_the_law_of_h_is_where_h_is():
    """H decays as e^{−γt}; measured 1.5e-3 away at h = 0.1 and 3.7e-4 at 0.05, as order two says."""
    gaps = []
    for h in (0.1, 0.05):
        lines = {name: y for name, y, _ in cb.solve("particle", "contact-strang", step=h).energies()}
        gaps.append(np.abs(lines["H"] - lines["law of H"]).max())
    assert 3 < gaps[0] / gaps[1] < 5
    assert gaps[1] < 4e-4


def test_notebooks_show_short_tables():
    for shown in (cb.solve("particle", "rk4", step=0.1), cb.SCENES["particle"], cb.SCENES, cb.METHODS):
        html = shown._repr_html_()
        assert html.startswith("<table>")
        assert html.endswith("</table>")
        assert html.count("<tr>") < 60
        assert "<lambda>" not in html
    assert "contact-rkn8" in cb.METHODS._repr_html_()


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda V: cb.Mechanical(potential=V, gamma=lambda t: t, **ONE), r"cb\.Driven\(rate=lambda t: …\)"),
        (lambda V: cb.Mechanical(potential=V, kinetic=V, **ONE), r"mass=\(1\., 2\., 5\.\)"),
        (lambda V: cb.Mechanical(potential=V, magnetic=V, **ONE), "no force may depend on p"),
        (lambda V: cb.Mechanical(potential=V, damping=V, **ONE), r"cb\.GeneralDamping"),
        (lambda V: cb.Driven(potential=lambda q, t: V(q), rate=lambda q, t: t, **ONE), "lambda t: …"),
        (lambda V: cb.solve("particle", "rk4", step=0.1, events=V), r"cb\.scipy\.Contact"),
        (lambda V: cb.solve("particle", "rk4", step=0.1, dense_output=True), r"cb\.scipy\.Contact"),
    ],
)
def test_a_refusal_is_one_line_with_the_nearest_way(make, says):
    with pytest.raises(cb.BadInput, match=says) as refusal:
        make(lambda q: q[0] ** 2 / 2)
    assert len(str(refusal.value)) <= 300
    assert "\n" not in str(refusal.value)


def test_three_masses_are_solved():
    given = {"q": (1.0, 1.0, 1.0), "p": (0.0, 0.0, 0.0), "t_end": 2.0, "mass": (1.0, 2.0, 5.0)}
    scene = cb.Mechanical(name="masses", potential=lambda q: sum(x * x for x in q) / 2, **given)
    end = cb.solve(scene, "contact-rkn6", step=0.05).q[-1]
    np.testing.assert_allclose(end, np.cos(2.0 / np.sqrt([1.0, 2.0, 5.0])), rtol=0, atol=1e-10)

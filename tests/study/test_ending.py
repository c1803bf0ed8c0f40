"""A run ends with its answers."""

from pathlib import Path

from contactbench.study.ending import ending

RESULTS = Path(__file__).parents[2] / "results"


def test_a_run_ends_with_the_answers_of_its_tables():
    text = ending(RESULTS)
    assert text.startswith("Of ")
    assert "\nDoes a method keep the momentum J wherever it claims to?\n    always" in text

"""What does round-off grow to in a run that is taken back?  One cell: a damping, a step, a force, a span."""


def test_reversibility(measure):
    measure()

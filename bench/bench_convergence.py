"""How fast does the error fall with the step?  One cell: a fixed-step method on a scene."""


def test_convergence(measure):
    measure()

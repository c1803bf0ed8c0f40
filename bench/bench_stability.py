"""Where do integrators break, and how?  One cell: a method on a hard scene, or a question of stability."""


def test_stability(measure):
    measure()


def test_rates(measure):
    measure()


def test_linear_stability(measure):
    measure()

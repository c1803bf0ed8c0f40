def test_stability(measure):
    measure()


def test_rates(measure):
    measure()


def test_linear_stability(measure):
    measure()

def test_scaling_errors(measure):
    measure()


def test_scaling(measure):
    measure()

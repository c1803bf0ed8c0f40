def test_gradients_errors(measure):
    measure()


def test_gradients(measure):
    measure()

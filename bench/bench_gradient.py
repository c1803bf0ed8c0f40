def test_gradients(measure):
    measure()

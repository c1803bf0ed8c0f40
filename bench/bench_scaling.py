def test_scaling(measure):
    measure()

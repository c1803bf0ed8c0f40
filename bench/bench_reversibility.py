def test_reversibility(measure):
    measure()

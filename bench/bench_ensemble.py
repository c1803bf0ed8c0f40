def test_ensemble(measure):
    measure()

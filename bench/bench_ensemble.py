def test_ensemble_errors(measure):
    measure()


def test_ensemble(measure):
    measure()

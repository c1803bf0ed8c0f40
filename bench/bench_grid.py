def test_run(measure):
    measure()


def test_times(measure):
    measure()

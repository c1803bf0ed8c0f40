def test_work_precision_errors(measure):
    measure()


def test_work_precision(measure):
    measure()

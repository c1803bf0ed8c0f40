"""What does accuracy cost?  One cell: a method on an engine, on a scene, at one setting."""


def test_work_precision_errors(measure):
    measure()


def test_work_precision(measure):
    measure()

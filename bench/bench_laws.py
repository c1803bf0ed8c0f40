"""Who keeps the laws?  One cell: a method on a scene at three steps or four tolerances."""


def test_laws(measure):
    measure()

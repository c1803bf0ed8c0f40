def test_structure_errors(measure):
    measure()


def test_structure(measure):
    measure()

"""What does keeping the structure buy?  One cell: a method at one setting, on a chaotic ring with weak damping."""


def test_structure_errors(measure):
    measure()


def test_structure(measure):
    measure()

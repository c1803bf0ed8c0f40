"""How does cost grow with the size of the problem?  One cell: a method on so many degrees of freedom and cores."""


def test_scaling(measure):
    measure()

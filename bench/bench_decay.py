"""What is kept at equal cost?  One cell: a method on a scene, its errors and decay laws at equal evaluations."""


def test_decay_laws(measure):
    measure()

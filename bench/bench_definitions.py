"""What was run?  One cell: a scene or a method, with the digest of its definition."""


def test_definition(measure):
    measure()

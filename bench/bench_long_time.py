"""What do long runs of a chaotic scene average to, and at what cost?  One cell: a method at all its settings."""


def test_long_time(measure):
    measure()

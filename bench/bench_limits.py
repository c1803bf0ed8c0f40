def test_borders(measure):
    measure()


def test_rates(measure):
    measure()

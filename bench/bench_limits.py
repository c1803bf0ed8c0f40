def test_borders(measure):
    measure()


def test_rates(measure):
    measure()


def test_ticks(measure):
    measure()

def test_population(measure):
    measure()


def test_population_hard(measure):
    measure()

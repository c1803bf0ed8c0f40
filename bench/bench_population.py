def test_population(measure):
    measure()

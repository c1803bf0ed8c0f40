def test_laws(measure):
    measure()

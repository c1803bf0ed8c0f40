def test_definition(measure):
    measure()

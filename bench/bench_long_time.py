def test_long_time(measure):
    measure()

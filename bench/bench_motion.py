def test_motion(measure):
    measure()

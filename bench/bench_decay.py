def test_decay_laws(measure):
    measure()

def test_ring_energy(measure):
    measure()


def test_ring_time(measure):
    measure()

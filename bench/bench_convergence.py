def test_convergence(measure):
    measure()

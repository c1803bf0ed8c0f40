def test_orders(measure):
    measure()

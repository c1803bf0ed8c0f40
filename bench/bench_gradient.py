"""What does a derivative of a loss in the parameters cost?  One cell: a method, how it is differentiated, an error."""


def test_gradients(measure):
    measure()

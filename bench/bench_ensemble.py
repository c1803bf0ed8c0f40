"""How many trajectories a second?  One cell: a method at one setting, on a number of trajectories and cores."""


def test_ensemble(measure):
    measure()

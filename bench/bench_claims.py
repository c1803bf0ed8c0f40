"""Is it true?  One cell: a claim of the paper, or the data of one of its figures."""


def test_claim(measure):
    measure()


def test_paper_figure(measure):
    measure()

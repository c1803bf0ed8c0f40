def test_claim(measure):
    measure()


def test_paper_figure(measure):
    measure()

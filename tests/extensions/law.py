"""A law of one's own: how far the mean of q has wandered."""

import numpy as np

from contactbench.measure.laws import law, truth

ABOUT = "|mean q − mean q*| over the saved times, first component"


@law(ABOUT, "mean q", applies=lambda scene: scene.kind == "mechanical")
def mean_position(solution):
    return float(abs(np.mean(solution.q[:, 0]) - np.mean(truth(solution).states().q[0])))

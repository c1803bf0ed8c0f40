"""What does keeping the structure buy?  One cell: a method at one setting, on a chaotic ring with weak damping.

Nobody follows such a trajectory for long; what is compared is the energy left, less the centre of mass's, and its rate.
"""

from __future__ import annotations

import math
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.stats import bootstrap

import contactbench as cb
from contactbench.measure.clock import Call
from contactbench.methods.base import CALLBACKS, Method
from contactbench.methods.fixed_step import FixedStep
from contactbench.methods.prepared import Prepared
from contactbench.numbers.protocol import Arithmetic, Vector
from contactbench.runs.experiment import Cell, Profile, Recorded, Row, Timing, experiment, timed_experiment
from contactbench.scene import Scene
from contactbench.scene.base import Elapsed
from contactbench.solution import Solution, keywords
from contactbench.tables.declared import RING as RING_TABLE

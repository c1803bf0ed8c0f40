"""Order conditions of explicit Runge–Kutta and Runge–Kutta–Nyström methods, by their trees.

A tree stands for a term of f(y(τ)), of power τ^e: it is the multiset of its branches, each a tree, whose integral, of a
Nyström method the double one, a stage has; a Nyström method's may also be y' itself, τ (LEAF).
Hairer, Nørsett, Wanner, Solving Ordinary Differential Equations I, §II.2 and §II.14.
"""

from fractions import Fraction
from functools import cache
from itertools import combinations_with_replacement, product

LEAF = "y'"


@cache
def trees(power, gap):
    """All trees of a power; gap : 1 of first-order equations, 2 of second-order ones."""
    if power == 0:
        return ((),)
    found = []
    for sizes in partitions(power, gap):
        kinds = [[(size, k) for k in range(len(branches(size, gap)))] for size in sorted(set(sizes))]
        counts = [sizes.count(own[0][0]) for own in kinds]
        choices = [combinations_with_replacement(own, n) for own, n in zip(kinds, counts, strict=True)]
        for chosen in product(*choices):
            found.append(tuple(branches(size, gap)[k] for part in chosen for size, k in part))
    return tuple(found)


@cache
def branches(size, gap):
    """Branches that contribute so much to the power of a tree."""
    leaf = (LEAF,) if gap == 2 and size == 1 else ()
    return leaf + (trees(size - gap, gap) if size >= gap else ())


def partitions(power, gap, least=1):
    if power == 0:
        yield ()
    for size in range(least, power + 1):
        if branches(size, gap):
            for rest in partitions(power - size, gap, size):
                yield (size, *rest)


def power_of(tree, gap):
    return sum(1 if branch == LEAF else power_of(branch, gap) + gap for branch in tree)


def exact(tree, gap):
    """The coefficient of τ^e."""
    value = Fraction(1)
    for branch in tree:
        if branch != LEAF:
            e = power_of(branch, gap)
            value *= exact(branch, gap) / ((e + 1) if gap == 1 else (e + 1) * (e + 2))
    return value


def defects(matrix, nodes, weights, order):
    """What is left of every order condition up to an order, for numbers of any kind."""
    gap, stages = len(weights), range(len(nodes))
    values = {}

    def at_stages(tree):
        if tree not in values:
            value = [1] * len(nodes)
            for branch in tree:
                if branch == LEAF:
                    value = [a * c for a, c in zip(value, nodes, strict=True)]
                else:
                    inner = at_stages(branch)
                    sums = (sum(a * inner[j] for j, a in enumerate(matrix[i]) if a) for i in stages)
                    value = [a * b for a, b in zip(value, sums, strict=True)]
            values[tree] = value
        return values[tree]

    for power in range(order):
        for tree in trees(power, gap):
            whole = exact(tree, gap)
            for row, more in zip(
                weights[::-1], range(1, gap + 1), strict=True
            ):  # y' of a Nyström method first
                if power + more <= order:
                    scale = power + 1 if more == 1 else (power + 1) * (power + 2)
                    target = whole / scale
                    yield sum(w * v for w, v in zip(row, at_stages(tree), strict=True) if w) - target

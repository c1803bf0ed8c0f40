"""Compositions of subflows as data, and the loop that runs them all.

A composition is the list of its stages, in the order in which they act, with exact coefficients.
Most are two-part splittings: kicks b and merged drifts a in turn, b1 a1 b2 a2 … b1.  Such a list is
also a composition of a first-order method χ and its adjoint, χ(α1 h) χ*(α2 h) χ(α3 h) … with
b1 = α1, a1 = α1 + α2, b2 = α2 + α3, … (McLachlan 1995, doi:10.1137/0916010), which is how it is read
where a scene comes in more than two parts: a body with anisotropic damping, damping without a merged
flow.  Neighbouring stages of one flow are merged, within a step and from one step to the next (first
same as last), so that for example Strang costs one gradient per step.

A composition may be processed: stages π before the first step, the same ones in reverse order π* after
the last, so that n steps are π χⁿ π*.  The kernel χ then need only be conjugate to a method of the
order, which leaves it far fewer conditions, and it is the kernel that is paid for at every step
(Blanes, Casas, Ros, SIAM J. Sci. Comput. 21, 711 (1999), doi:10.1137/S1064827598332497).

Published tables have 15 to 26 digits.  The ones here are the solutions of the order conditions next to
them, to 50 digits (Newton's method in the free algebra of the two parts, modulo [B, [B, [B, A]]] for
the Nyström ones); none differs from print by more than a few units in the last digit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from contactbench.flows import Flow, damped_time, flows_of, rotation, spin, top_rate, turn_rate
from contactbench.scene import BodyState, RigidBody, Scene

Stage = tuple[str, Fraction]
HALF, ONE = Fraction(1, 2), Fraction(1)


@dataclass(frozen=True)
class Composition:
    """A composition: `stages` act left to right; `order` is its order for γ > 0.

    nystrom : the order rests on [B, [B, [B, A]]] = 0, which holds for kicks and (merged) drifts
    only; elsewhere the composition is refused.
    processor : stages that act once before the first step and, in reverse order, once after the last
    (Nyström compositions).  Palindromic stages between them make the whole run palindromic.
    """

    name: str
    order: int
    stages: tuple[Stage, ...]
    source: str
    nystrom: bool = False
    processor: tuple[Stage, ...] = ()

    @property
    def palindromic(self) -> bool:
        """Whether the stages read the same backwards, which makes the method time-symmetric."""
        return self.stages == self.stages[::-1]

    @property
    def two_part(self) -> bool:
        """Whether it is a splitting into kicks and merged drifts."""
        return {name for name, _ in self.stages} == {"kick", "drift_damp"}

    def alphas(self) -> list[Fraction]:
        """The coefficients of χ and χ* in turn (two-part compositions)."""
        alphas: list[Fraction] = []
        for _, coefficient in self.stages[:-1]:
            alphas.append(coefficient - (alphas[-1] if alphas else 0))
        return alphas

    def run(self, n: int) -> tuple[Stage, ...]:
        """The stages of n steps, one list from start to end."""
        return merged((*self.processor, *self.stages * n, *reversed(self.processor)))


def palindrome(first: str, second: str, half: Sequence[Any], total: int) -> tuple[Stage, ...]:
    """A palindromic two-part list of `total` stages from the coefficients printed for its first half.

    Consistency supplies the rest: the coefficients of each part add up to one.  `half` alternates
    first, second, first, …; what is missing is the middle pair.
    """
    printed = [Fraction(str(c)) for c in half]
    middle = total // 2
    names = [(first, second)[i % 2] for i in range(total)]
    given: dict[str, Fraction] = {first: Fraction(0), second: Fraction(0)}
    for name, coefficient in zip(names, printed, strict=False):
        given[name] += coefficient
    beside = HALF - given[names[middle - 1]]  # stands twice
    centre = ONE - 2 * given[names[middle]]  # stands once
    left = [*printed, beside]
    assert len(left) == middle
    return tuple(zip(names, [*left, centre, *reversed(left)], strict=True))


def balanced(first: str, second: str, coefficients: Sequence[Any]) -> tuple[Stage, ...]:
    """A two-part list whose coefficients of each part add up to nothing: two more than the ones printed."""
    stages = [((first, second)[i % 2], Fraction(str(c))) for i, c in enumerate(coefficients)]
    for _ in range(2):
        name = (first, second)[len(stages) % 2]
        stages.append((name, -sum((c for other, c in stages if other == name), Fraction(0))))
    return tuple(stages)


def strang_composition(gammas: Iterable[Any]) -> tuple[Stage, ...]:
    """Strang steps of sizes γ1, γ2, … one after another, neighbouring kicks merged."""
    stages: list[Stage] = []
    for gamma in map(Fraction, gammas):
        stages += [("kick", gamma / 2), ("drift_damp", gamma), ("kick", gamma / 2)]
    return merged(stages)


def merged(stages: Iterable[Stage]) -> tuple[Stage, ...]:
    """Neighbours of the same flow added up."""
    out: list[Stage] = []
    for name, coefficient in stages:
        if out and out[-1][0] == name:
            out[-1] = (name, out[-1][1] + coefficient)
        else:
            out.append((name, coefficient))
    return tuple(out)


PRINTED = Composition(
    "contact-printed", 1,
    (("kick", HALF), ("damp", ONE), ("drift", ONE), ("kick", HALF)),
    "the paper, eq. Strang-Integrator, read right to left: B½, C, A, B½",
)  # fmt: skip

ABC = Composition(
    "contact-abc", 2,
    (("kick", HALF), ("drift", HALF), ("damp", ONE), ("drift", HALF), ("kick", HALF)),
    "the palindromic three-part splitting; Bravetti, Seri, Vermeeren, Zadra, Celest. Mech. Dyn. Astron. "
    "132, 7 (2020), doi:10.1007/s10569-019-9946-9",
)  # fmt: skip

STRANG = Composition(
    "contact-strang", 2,
    (("kick", HALF), ("drift_damp", ONE), ("kick", HALF)),
    "Strang, SIAM J. Numer. Anal. 5, 506 (1968), doi:10.1137/0705041, on V and T + γs",
)  # fmt: skip

BLANES_MOAN = "Blanes, Moan, J. Comput. Appl. Math. 142, 313 (2002), doi:10.1016/S0377-0427(01)00492-7"

BM4 = Composition(
    "contact-bm4", 4,
    palindrome(
        "kick", "drift_damp",
        (
            "0.079203696431195669433663495888260798438386669927815",
            "0.20951510661336202127407264002949039971368957530527",
            "0.35317290604977398848106131157312333164277031093604",
            "-0.14385177317981800827511505785653618701033259713195",
            "-0.042065080357719535368110298302515207686514298192775",
        ),
        13,
    ),
    f"S6 of {BLANES_MOAN}",
)  # fmt: skip

BM6 = Composition(
    "contact-bm6", 6,
    palindrome(
        "kick", "drift_damp",
        (
            "0.050262764400392686021221654402397513629577787569618",
            "0.1488164479010432319209010055360047916700944368305",
            "0.41351430042834381506306372013091290903522165849761",
            "-0.1323858657677836474488454265998966699569670767424",
            "0.045079889794398062968897052124940537763958704107536",
            "0.067307604692184458150257896592082543718256196906123",
            "-0.18805485381956891479912848891626252441530182136536",
            "0.43266640257817359752766797088454962323046694953908",
            "0.54196067845078013483141474093199460128604741047017",
        ),
        21,
    ),
    f"S10 of {BLANES_MOAN}",
)  # fmt: skip

RKN4 = Composition(
    "contact-rkn4", 4,
    palindrome(
        "kick", "drift_damp",
        (
            "0.082984406417405018838347478942265881558838163780929",
            "0.24529895718427116260393242600141783223311001879892",
            "0.39630980149836807709491152826365930198137621752971",
            "0.60487266571107997496089269764306760781459593913832",
            "-0.039056304922348435170865290765367112585752451476464",
        ),
        13,
    ),
    f"SRKN6b of {BLANES_MOAN}",
)  # fmt: skip

RKN6 = Composition(
    "contact-rkn6", 6,
    palindrome(
        "kick", "drift_damp",
        (
            "0.041464998518262843298778133916980363329979264472426",
            "0.12322977594627115156108638033741953478048446514427",
            "0.1981286719180665411367264731820410168042880747604",
            "0.29055379779955827036641416932431729650341126625154",
            "-0.040006192104152686888828363536154469243445061813333",
            "-0.12704921262541691566250505382923211008325120941956",
            "0.075253984301580341127878878525511443979020626422923",
            "-0.24633176106207540419497348910506449470832789179453",
            "-0.011511387420687770062443201500596928412724038204632",
            "0.35720887279592775261986034962403529482885932820439",
        ),
        23,
    ),
    f"SRKN11b of {BLANES_MOAN}", nystrom=True,
)  # fmt: skip

# Found by Newton's method from random starts.  Kernel: 13 stages, 14 − 2 consistent parameters, and the
# 1 + 2 + 5 conditions of degree 3, 5 and 7 for a time-symmetric method to be conjugate to order 8; of
# the solutions met, that with the smallest leading error, the parts of degree 9 that no processor
# removes (weighted 100) and the part of degree 8 that the processor would have to supply.  Processor:
# the 26 conditions that its logarithm be the conjugation up to degree 7, among the solutions met that
# of the smallest coefficients.  Kernels and processors were compared on Hénon–Heiles, coupled pendula
# and the potential q1²q2², none of them a scene here.
RKN8 = Composition(
    "contact-rkn8", 8,
    palindrome(
        "drift_damp", "kick",
        (
            "-0.037087380456747430688368995277224020188573135083406",
            "0.07485206416529386921230256055332740852362196241037",
            "-0.051031696465799471106816762992760499620799363339497",
            "-0.079792074136650552156379854928346122033118598707705",
            "-0.16600794409994134657258642091881399390999757928972",
            "0.0044571932925694125393117795771810182856288324679514",
            "0.36306835029540571374191832828872301208011351020852",
            "0.19373984154963269502384585604479253580335520007716",
            "0.23563392689463614493805807209796760973055372412487",
            "-0.087185737979965480013482866140340042735171104098752",
            "-0.039782227772119742294144653437389762698073757096257",
            "0.28789966568690919924694864078836167897563698395771",
        ),
        27,
    ),
    "kernel of 13 stages and processor of 13, derived here from the order conditions", nystrom=True,
    processor=balanced(
        "drift_damp", "kick",
        (
            "0.070514925777936012012668886963256591939211632838262",
            "-0.084131039684989077262963484874728814583123704068104",
            "0.2925468768738881350246379252167112998325084154009",
            "0.00049780725989633267456906066656073117824996347949124",
            "-0.17019923780815188228930630658870043674415770604181",
            "0.015167411765776938209632262217813899829843967199728",
            "-0.24700694056430219561405540701778532325295974015966",
            "-0.039339101641317136964240007277559479590762756671507",
            "0.18658705865443389056960684910609126403448493046574",
            "-0.039431755939464070530495150997676508967983525814219",
            "-0.17829552206194901969796237993047998951622571555908",
            "0.014527458603364490579539037754177336842718025264845",
            "0.10271130566948693976337222798305513369666044166097",
            "0.12482062863990015290088559950560817960698474666573",
            "-0.13020985769473103643210818209867537818989117506866",
            "0.083318420771153904337146651758064437288350616744159",
            "-0.20565702122535208155392445902224595243902702372526",
            "-0.0037741136024227068874324095678494839979087214915938",
            "0.33218255097965166228151497210193725577253059013722",
            "0.072322288034870999177282554684410088589190028750349",
            "-0.16367804499246382384537986053226588316388677263549",
            "0.042488485206775721930051424221202092585763477563909",
            "0.039901379333993978334716935434180597827870188217062",
            "-0.07244025151803453302283655353039359595159575317472",
            "0.1264189594309054959521289619269493647151729253326",
        ),
    ),
)  # fmt: skip

_KAHAN_LI = (
    "0.13020248308889008087881763209670052235723185436506",
    "0.56116298177510838456196440770015056726615922120603",
    "-0.3894749626448472864080785982352483888360299624802",
    "0.15884190655515560089621074570715248141215492833811",
    "-0.39590389413323757733623153934793893602680169266742",
    "0.18453964097831570709183254153337546281900077254789",
    "0.25837438768632204729397910999493947181308868214327",
    "0.2950117236093102988709662402182281129765178453897",
)  # fmt: skip

O8 = Composition(
    "contact-o8", 8,
    strang_composition([*_KAHAN_LI, 1 - 2 * sum(map(Fraction, _KAHAN_LI)), *reversed(_KAHAN_LI)]),
    "s17odr8b of Kahan, Li, Math. Comput. 66, 1089 (1997), doi:10.1090/S0025-5718-97-00873-9, on Strang",
)  # fmt: skip

COMPOSITIONS = (PRINTED, ABC, STRANG, BM4, BM6, RKN4, RKN6, RKN8, O8)


def number(coefficient: Fraction, xp: Any) -> Any:
    """A coefficient as a number of the namespace: exact in mpmath, else a Python float."""
    if hasattr(xp, "mpf"):
        return xp.mpf(coefficient.numerator) / coefficient.denominator
    return float(coefficient)


# -- a composition on a scene ----------------------------------------------------------------------
def refusal(composition: Composition, scene: Scene) -> str | None:
    """Why the composition does not have its order on this scene, or None."""
    if composition.nystrom and "drift_damp" not in flows_of(scene):
        return f"{composition.name} needs kicks and a merged drift and damping; scene {scene.name!r} has none"
    return None


def parts(scene: Scene) -> tuple[str, ...]:
    """The flows χ is made of, in their order."""
    if isinstance(scene, RigidBody):
        return ("turn", "top") if scene.isotropic else ("turn", "damp", "top")
    return ("kick", "drift_damp") if "drift_damp" in flows_of(scene) else ("kick", "drift", "damp")


def stages_on(composition: Composition, scene: Scene) -> tuple[Stage, ...]:
    """The stages of one step on a scene."""
    if {name for name, _ in composition.stages} <= flows_of(scene).keys():
        return composition.stages
    if composition.two_part:
        order = parts(scene)
        stages = []
        for k, alpha in enumerate(composition.alphas()):
            stages += [(name, alpha) for name in (order if k % 2 == 0 else order[::-1])]
        return merged(stages)
    stages = []
    for name, coefficient in composition.stages:  # a body has no kick; its drift is a palindrome
        if name == "drift":
            stages += [("turn", coefficient / 2), ("top", coefficient), ("turn", coefficient / 2)]
        elif name == "damp":
            stages.append((name, coefficient))
    return merged(stages)


@dataclass(frozen=True)
class Plan:
    """One step written out for a scene: what opens a run, what closes a step, what joins two."""

    opening: tuple[Stage, ...]
    inner: tuple[Stage, ...]
    closing: tuple[Stage, ...]
    joint: tuple[Stage, ...]

    def count(self, flows: dict[str, Flow], kind: str, n: int) -> int:
        """How many operations of a kind n steps take."""

        def cost(stages: tuple[Stage, ...]) -> int:
            return sum(flows[name].costs.get(kind, 0) for name, _ in stages)

        return cost(self.opening) + n * cost(self.inner) + (n - 1) * cost(self.joint) + cost(self.closing)


def plan(composition: Composition, scene: Scene) -> Plan:
    """The composition on a scene, with the merged joint where first and last flow are the same."""
    stages, before = stages_on(composition, scene), composition.processor
    first, last = stages[0], stages[-1]
    if len(stages) == 1 or first[0] != last[0]:
        return Plan(before, stages, before[::-1], ())
    inner, joint = stages[1:-1], merged((last, first))
    if not (before or by_the_clock(composition, scene)):
        return Plan((first,), inner, (last,), joint)
    # the last joint runs one first stage too far, which is taken back at the end
    back = (first[0], -first[1])
    return Plan(merged((*before, first)), (*inner, *joint), merged((back, *before[::-1])), ())


Repeat = Callable[[Any, Callable[[Any], Any], Any], Any]


#: a `repeat` with a true attribute `roll` asks for loops over stages too


def repeat(n: int, body: Callable[[Any], Any], x: Any) -> Any:
    """n-fold application as a plain loop (the JAX engine passes its own)."""
    for _ in range(n):
        x = body(x)
    return x


def advance(
    composition: Composition, scene: Any, x: Any, h: Any, n: Any, xp: Any, repeat: Repeat = repeat
) -> Any:
    """n ≥ 1 steps of size h from state x.

    Merging at the joints leaves the map unchanged up to round-off.
    """
    if by_the_clock(composition, scene):
        return advance_by_the_clock(composition, scene, x, h, n, xp, repeat)
    flows = flows_of(scene)
    steps = plan(composition, scene)
    opening, inner, closing, joint = steps.opening, steps.inner, steps.closing, steps.joint
    constants = stage_constants((*opening, *inner, *closing, *joint), scene, h, xp)
    rolled = getattr(repeat, "roll", False)

    def run(stages: Sequence[Stage], x: Any) -> Any:
        """The stages one after another: written out, or a loop over the period of their flows."""
        if rolled and len(stages) % 2 and len(stages) > 1:  # a processor: one stage ahead of the pairs
            return run(stages[1:], run(stages[:1], x))
        flows_in_turn = [name for name, _ in stages]
        period = shortest_period(flows_in_turn) if rolled and stages else len(stages)
        columns = [constants(stages[i::period]) for i in range(period)]

        def round_of(k: Any, x: Any) -> Any:
            for name, column in zip(flows_in_turn, columns, strict=False):
                x = flows[name].apply(scene, x, column(k), xp)
            return x

        if period == len(stages):
            return round_of(0, x)
        return repeat(
            len(stages) // period, lambda carried: (round_of(carried[1], carried[0]), carried[1] + 1), (x, 0)
        )[0]

    x = run(opening, x)
    if not joint:
        return run(closing, repeat(n, lambda x: run(inner, x), x))
    x = repeat(n - 1, lambda x: run((*inner, *joint), x), x)
    return run((*inner, *closing), x)


def shortest_period(names: list[str]) -> int:
    """The length of the shortest list whose repetition is `names`."""
    size = len(names)
    return next(p for p in range(1, size + 1) if size % p == 0 and names == names[:p] * (size // p))


def stage_constants(
    stages: Iterable[Stage], scene: Any, h: Any, xp: Any
) -> Callable[[Sequence[Stage]], Callable[[Any], Any]]:
    """The constants of every stage, computed once: ``constants(some)(k)`` are those of the k-th of some
    stages of one flow.

    For array namespaces all stages of a flow are one vector: an exponential for all of them costs what
    one costs, and compiled code reads its scalars where it needs them.  h may itself be an array, one
    entry for each member of an ensemble.
    """
    flows, distinct = flows_of(scene), list(dict.fromkeys(stages))
    if not hasattr(xp, "asarray"):
        scalars = {(f, c): flows[f].constants(scene, number(c, xp) * h, xp) for f, c in distinct}
        return lambda some: [scalars[stage] for stage in some].__getitem__
    coefficients = {name: [c for f, c in distinct if f == name] for name, _ in distinct}
    vectors = {
        name: flows[name].constants(scene, xp.multiply.outer(xp.asarray([number(c, xp) for c in cs]), h), xp)
        for name, cs in coefficients.items()
    }

    def constants(some: Sequence[Stage]) -> Callable[[Any], Any]:
        name = some[0][0]
        rows = [coefficients[name].index(c) for _, c in some]
        if len(rows) == 1:
            return lambda k: entry(vectors[name], rows[0])
        column = entry(vectors[name], xp.asarray(rows))
        return lambda k: entry(column, k)

    return constants


def entry(constants: Any, i: Any) -> Any:
    """Entry i of constants that are a vector, None, or a tuple of such; several for an array i."""
    if isinstance(constants, tuple):
        return tuple(entry(c, i) for c in constants)
    return None if constants is None else constants[i]


def by_the_clock(composition: Composition, scene: Scene) -> bool:
    """Whether `advance_by_the_clock` is the way."""
    return composition.two_part and isinstance(scene, RigidBody) and scene.isotropic


def advance_by_the_clock(
    composition: Composition, scene: RigidBody, x: BodyState, h: Any, n: Any, xp: Any, repeat: Repeat
) -> BodyState:
    """The free body and isotropic damping together, without splitting the two.

    Damping only rescales the free body's clock: m = e^{γt} M and R move as if undamped in the time τ,
    dτ = e^{−γt} dt, of which a step from t takes e^{−γt} φ(h).  What is left of damping is one factor on M
    and s at the end; and the spin commutes with all else, so that one for all steps does.  The last step
    is like the others, joined to the opening of a next one, which is then taken back: what a compiled
    program has beside its loops costs it more than a rotation.
    """
    stages, gamma, decay = stages_on(composition, scene), scene.gamma, xp.exp(-scene.gamma * h)
    tau = damped_time(gamma, h, xp)
    smallest, middle, largest = scene.by_inertia
    first, *turns = (c for name, c in stages if name == "turn")
    opening = tau * turn_rate(scene) * number(first, xp)
    turned = scaled(turns, tau * turn_rate(scene), xp)
    topped = scaled((c for name, c in stages if name == "top"), tau * top_rate(scene), xp)
    rounds = len(turns)

    def both(x: BodyState, about_largest: Any, about_smallest: Any) -> BodyState:
        return rotation(rotation(x, largest, about_largest, xp), smallest, about_smallest, xp)

    def first_rounds(x: BodyState, clock: Any) -> BodyState:
        """All rounds of a step but its last: written out, or a loop where short code matters more."""
        if not getattr(repeat, "roll", False):
            for k in range(rounds - 1):
                x = both(x, clock * topped[k], clock * turned[k])
            return x

        def another(carried: tuple[BodyState, Any]) -> tuple[BodyState, Any]:
            x, k = carried
            return both(x, clock * topped[k], clock * turned[k]), k + 1

        return repeat(rounds - 1, another, (x, 0))[0]

    joint = turned[-1] + decay * opening  # the next step starts on a slower clock

    def step(carried: tuple[BodyState, Any]) -> tuple[BodyState, Any]:
        x, clock = carried
        return both(first_rounds(x, clock), clock * topped[-1], clock * joint), clock * decay

    one = xp.exp(0 * h)  # as a number of the engine's kind
    x, clock = repeat(n, step, (rotation(x, smallest, opening, xp), one))
    x = rotation(x, smallest, -clock * opening, xp)
    x = spin(x, damped_time(gamma, h * n, xp) * scene.inverse_inertia[middle], xp)
    total = xp.exp(-gamma * h * n)
    return BodyState(tuple(total * m for m in x.M), x.R, None if x.s is None else total * x.s)


def scaled(coefficients: Iterable[Fraction], factor: Any, xp: Any) -> Any:
    """The coefficients times a factor: one vector for array namespaces, else a list."""
    values = [number(c, xp) for c in coefficients]
    return (
        xp.multiply.outer(xp.asarray(values), factor)
        if hasattr(xp, "asarray")
        else [c * factor for c in values]
    )

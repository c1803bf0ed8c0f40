"""Do splittings for weak damping pay?  The free body in closed form ∘ damping; the error falls with the damping.

With damping of size ε a palindrome A_{a₁h} B_{b₁h} A_{a₂h} … of `free` (A) and `damp` (B) has a local error of
terms ε^i h^j, and the terms with one factor ε matter most.  A table (n, m, …) has a global error
O(ε hⁿ + ε² hᵐ + …).  With the nodes x_i = a₁ + … + a_i − ½, the terms in ε vanish to order n when (x_i, b_i) is a
quadrature rule for x⁰ … x^{n−2} on [−½, ½], those in ε² to order m when

    Σ_{i<j} b_i b_j x_i^k x_j^l + ½ Σ_i b_i² x_i^{k+l} = ∫_{x<y} x^k y^l,   k + l = 1, 3, … ≤ m − 3.

(8,4): McLachlan, BIT 35, 258 (1995), doi:10.1007/BF01737165; (8,6,4) and (10,6,4): Blanes, Casas, Farrés, Laskar,
Makazaga, Murua, Appl. Numer. Math. 68, 58 (2013), doi:10.1016/j.apnum.2013.01.003.  The coefficients here solve
these conditions to 50 digits and agree with print (see the tests).

``python bench/near_integrable.py`` prints what an error costs: weakly damped anisotropic bodies, of moments 1, 2, 3,
tumbling, and a needle; these tables, the palindrome of the same two flows, compositions of two rotations, and the
fastest peers, all compiled: µs for errors of 10⁻³, 10⁻⁶ and 10⁻⁹, an asterisk at the least.

They are no registered methods, because they win nowhere per unit of time: none of the three is the cheapest on any
of these bodies.  A free flow costs 0.5 µs, as much as a dozen steps of rotations; where steps may be so long that
this pays, as at 10⁻³ on the needle, the palindrome `contact-abc` needs a third of their time, and less than a tenth
of the peers'.
"""

from __future__ import annotations

import math
from time import perf_counter

import numpy as np

import contactbench as cb
from contactbench.measure.ladder import tolerances
from contactbench.methods.contact import contact_method
from contactbench.splitting.composition import Composition, palindrome

BLANES = (
    "Blanes, Casas, Farrés, Laskar, Makazaga, Murua, Appl. Numer. Math. 68, 58 (2013), "
    "doi:10.1016/j.apnum.2013.01.003"
)

ABA84 = Composition(
    "aba-84", 4,
    palindrome(
        "free", "damp",
        (
            "0.075346960269892888416527803683474464372652664554079",
            "0.19022593937367661924523076273845389746120361990487",
            "0.51791685468825678230077397849631564432384744782198",
            "0.84652407044352625705508054464677583417711374239468",
        ),
        11,
    ),
    "McLachlan, BIT 35, 258 (1995), doi:10.1007/BF01737165",
)  # fmt: skip

ABA864 = Composition(
    "aba-864", 4,
    palindrome(
        "free", "damp",
        (
            "0.07113342649822311777793873000615499641740229592374",
            "0.1830836874721972219617037571664302910726241265516",
            "0.24115342795664009873648779532628964961781467804934",
            "0.31078285989857486950752229105426279637515732111626",
            "0.52141176177281478921213607806799422999143647885026",
            "-0.026564618511958800697212137916498759266329772852548",
        ),
        15,
    ),
    f"(8,6,4) of {BLANES}",
)  # fmt: skip

ABA1064 = Composition(
    "aba-1064", 4,
    palindrome(
        "free", "damp",
        (
            "0.038094497422412195456975322308637565340660060395807",
            "0.095858880837075210610771503771458847769342226040715",
            "0.14529871611691374929402007266066374974430888514613",
            "0.20444615314299878068050778391643447797632995861737",
            "0.20762769572554125071620561132498820651583696844616",
            "0.21707034797899110171433859243063367145297598204211",
            "0.43590970365152615922315486240106518440068879649433",
        ),
        17,
    ),
    f"(10,6,4) of {BLANES}",
)  # fmt: skip

#: exponents n and m of the error ε hⁿ + ε² hᵐ
NEAR_INTEGRABLE = {ABA84: (8, 4), ABA864: (8, 6), ABA1064: (10, 6)}

WEAK = cb.SCENES["rigid_body_anisotropic"]
RATES = np.array(WEAK.damping).diagonal()
SCENES = [
    WEAK.with_(name="strongly damped"),
    WEAK.with_(name="damped by 1e-2 of that", damping=1e-2 * RATES, t_end=200.0),
    WEAK.with_(name="damped by 1e-4 of that", damping=1e-4 * RATES, t_end=200.0),
    WEAK.with_(name="tumbling, 1e-3", damping=1e-3 * RATES, M=(1e-8, 1.0, 1e-8), t_end=200.0),
    WEAK.with_(name="needle, 1e-3", damping=1e-3 * RATES, M=(0.02, 1.0, 0.5), inertia=(1e-3, 1.0, 1.001)),
]
TABLES = [contact_method(table) for table in NEAR_INTEGRABLE]
OTHERS = ("contact-abc", "contact-bm6", "contact-o8", "heyoka-taylor", "cyrk-vern8", "cyrk-dop853")
ERRORS = (1e-3, 1e-6, 1e-9)
#: steps over the whole span, coarse to fine
STEPS = [round(5 * 2 ** (k / 2)) for k in range(21)]
#: seconds for which a call is repeated, of which the fastest counts; longer ones are not tried
REPEAT, LONGEST = 0.02, 5e-3


def fastest(run):
    end, best = perf_counter() + REPEAT, math.inf
    while perf_counter() < end:
        start = perf_counter()
        run.bare(run.start)
        best = min(best, perf_counter() - start)
    return best


def curve(scene, method):
    """(error, seconds) over the settings of a method."""
    for value in tolerances(method) if method.adaptive else [scene.t_end / n for n in STEPS]:
        run = cb.prepare(scene, method.name, save_at=[scene.t_end], carry=(), **{method.control: value})
        solution = run()
        if not solution.ok:
            continue
        seconds = fastest(run)
        yield cb.LAWS["solution_error"](solution), seconds
        if seconds > LONGEST:
            return


def main():
    for method in TABLES:
        cb.METHODS.add(method)
    for scene in SCENES:
        print(scene.name)
        found = {}
        for method in (*TABLES, *(cb.METHODS[name] for name in OTHERS)):
            points = list(curve(scene, method))
            found[method.name] = [
                min((s for e, s in points if e <= error), default=math.inf) for error in ERRORS
            ]
        least = [min(column) for column in zip(*found.values(), strict=True)]
        for name, seconds in found.items():
            marks = ["*" if s == best else " " for s, best in zip(seconds, least, strict=True)]
            print(f"  {name:14}", *(f"{1e6 * s:9.1f}{m}" for s, m in zip(seconds, marks, strict=True)))


if __name__ == "__main__":
    main()

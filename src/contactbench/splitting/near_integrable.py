"""Splittings for weak damping: the free body in closed form ∘ damping, whose error is proportional to the damping.

With damping of size ε a palindrome A_{a₁h} B_{b₁h} A_{a₂h} … of `free` (A) and `damp` (B) has a local error of
terms ε^i h^j, and the terms with one factor ε matter most.  A table (n, m, …) has a global error
O(ε hⁿ + ε² hᵐ + …).  With the nodes x_i = a₁ + … + a_i − ½, the terms in ε vanish to order n when (x_i, b_i) is a
quadrature rule for x⁰ … x^{n−2} on [−½, ½], those in ε² to order m when

    Σ_{i<j} b_i b_j x_i^k x_j^l + ½ Σ_i b_i² x_i^{k+l} = ∫_{x<y} x^k y^l,   k + l = 1, 3, … ≤ m − 3.

(8,4): McLachlan, BIT 35, 258 (1995), doi:10.1007/BF01737165; (8,6,4) and (10,6,4): Blanes, Casas, Farrés, Laskar,
Makazaga, Murua, Appl. Numer. Math. 68, 58 (2013), doi:10.1016/j.apnum.2013.01.003.  The coefficients here solve
these conditions to 50 digits and agree with print (see the tests).

They are no registered methods, because they win nowhere per unit of time.  ``python bench/near_integrable.py``
measures it: on five bodies damped by 1 down to 10⁻⁴ of `rigid_body_anisotropic`, tumbling and a needle among
them, at errors of 10⁻³, 10⁻⁶ and 10⁻⁹, none of the three is the cheapest.  A free flow costs 0.5 µs, as much as a
dozen steps of rotations; where steps may be so long that this pays, as at 10⁻³ on the needle, the palindrome
`contact-abc` of the same two flows needs a third of their time, and less than a tenth of the peers'.
"""

from __future__ import annotations

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

"""The truth: closed forms, frozen high-precision files, live high-precision solutions."""

from contactbench.truth.engines import (
    BlowUp,
    OutOfTime,
    Rows,
    agreeing_digits,
    decimal_context,
    disagreement,
    distance,
    extrapolation,
    matching_digits,
    place,
    rounded,
    scales,
    taylor,
    with_decimals,
)
from contactbench.truth.frozen import condition_number, digest, frozen, frozen_folder, manifest, table
from contactbench.truth.reference import (
    BLOW_UP_COLLAPSE,
    Reference,
    blow_up_time,
    confirmed,
    live,
    reference,
    taylor_blow_up,
)

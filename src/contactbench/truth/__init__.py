"""The truth: closed forms, frozen high-precision files, live high-precision solutions."""

from contactbench.truth.base import BlowUp, OutOfTime, Reference, checked_times, digest, with_decimals
from contactbench.truth.closed_form import closed_form_columns
from contactbench.truth.digits import (
    Rows,
    agreeing_digits,
    decimal_context,
    disagreement,
    distance,
    matching_digits,
    place,
    print_columns,
    rounded,
    scales,
)
from contactbench.truth.extrapolation import extrapolated, extrapolation
from contactbench.truth.frozen import condition_number, frozen, frozen_folder, manifest, table
from contactbench.truth.reference import (
    BLOW_UP_COLLAPSE,
    blow_up_time,
    confirmed,
    live,
    reference,
    taylor_blow_up,
)
from contactbench.truth.taylor import taylor

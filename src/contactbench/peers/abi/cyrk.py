"""The C interface of CyRK, and whether the installed one has it."""

from __future__ import annotations

from functools import cache
from typing import Any

from contactbench.peers.abi import signature

#: the solver as its C entry, as `abi.signature` reads it
SOLVE = "ppddpzizzpzzzbpzppzpzpzddb"
#: getters of the result: ours → its name in `CyRK.nb.numba_c_api`, its type in `CyRK.nb.numba_solver`, its signature
GETTERS = {
    "status": ("get_status_func_ptr", "int_func_sig", "ip"),
    "size": ("get_size_func_ptr", "size_func_sig", "zp"),
    "steps": ("get_steps_taken_func_ptr", "size_func_sig", "zp"),
    "states": ("get_y_func_ptr", "ptr_func_sig", "ap"),
    "arguments": ("get_args_ptr_func_ptr", "char_ptr_sig", "ap"),
    "time": ("get_t_now_func_ptr", "dbl_func_sig", "dp"),
    "state": ("get_y_now_ptr_func_ptr", "ptr_func_sig", "ap"),
    "free": ("get_free_func_ptr", "free_func_sig", "vp"),
}
#: CyRK's status codes
SUCCESS, TOO_MANY_STEPS, TOO_MANY_STEPS_SO_FAR = 1, -52, -53


@cache
def why_not() -> str:
    """Return why CyRK cannot be used, "" where it can."""
    try:
        import CyRK
        from CyRK.nb import numba_c_api, numba_solver
    except ImportError as error:  # also its own refusal of a processor without AVX2
        return f"CyRK cannot be imported: {error}"
    expected = [("get_solve_func_ptr", "solve_func_sig", SOLVE), *GETTERS.values()]
    for name, kind, word in expected:
        result, arguments = signature(word)
        found: Any = getattr(numba_solver, kind, None)
        alike = (
            hasattr(numba_c_api, name)
            and found is not None
            and found._argtypes_ == arguments
            and (word[0] == "a" or found._restype_ is result)
        )
        if not alike:
            return f"CyRK {CyRK.__version__} has another C interface than 0.20, which this is written for"
    return ""

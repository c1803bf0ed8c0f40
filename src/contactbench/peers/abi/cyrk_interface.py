"""Whether the installed CyRK has the C interface that cyrk_driver.py is written for."""

from __future__ import annotations

from ctypes import c_bool, c_double, c_int, c_size_t, c_void_p
from functools import cache

_solve = (
    c_void_p, c_double, c_double, c_void_p, c_size_t, c_int, c_size_t, c_size_t, c_void_p, c_size_t, c_size_t,
    c_size_t, c_bool, c_void_p, c_size_t, c_void_p, c_void_p, c_size_t, c_void_p, c_size_t, c_void_p, c_size_t,
    c_double, c_double, c_bool,
)  # fmt: skip
#: what the compiled calls return of a run, followed by the state reached
FACTS = ("status", "reached", "saved", "steps", "evaluations")
KNOWN = len(FACTS)
#: getters of the result: ours → (its name in `CyRK.nb.numba_c_api`, its type in `CyRK.nb.numba_solver`)
GETTERS = {
    "status": ("get_status_func_ptr", "int_func_sig"),
    "size": ("get_size_func_ptr", "size_func_sig"),
    "steps": ("get_steps_taken_func_ptr", "size_func_sig"),
    "states": ("get_y_func_ptr", "ptr_func_sig"),
    "arguments": ("get_args_ptr_func_ptr", "char_ptr_sig"),
    "time": ("get_t_now_func_ptr", "dbl_func_sig"),
    "state": ("get_y_now_ptr_func_ptr", "ptr_func_sig"),
    "free": ("get_free_func_ptr", "free_func_sig"),
}


@cache
def why_not() -> str:
    """Empty, or why CyRK cannot be used."""
    try:
        import CyRK
        from CyRK.nb import numba_c_api, numba_solver
    except ImportError as error:  # also its own refusal of a processor without AVX2
        return f"CyRK cannot be imported: {error}"
    differ = f"CyRK {CyRK.__version__} has another C interface than 0.20, which this is written for"
    names = [name for name, _ in GETTERS.values()] + ["get_solve_func_ptr"]
    if not all(hasattr(numba_c_api, name) for name in names):
        return differ
    signature = getattr(numba_solver, "solve_func_sig", None)
    if signature is None or signature._argtypes_ != _solve or signature._restype_ is not c_void_p:
        return differ
    for _, kind in GETTERS.values():
        if getattr(numba_solver, kind, None) is None or getattr(numba_solver, kind)._argtypes_ != (c_void_p,):
            return differ
    return ""

"""CVODE's own C library, the one that scikit-sundae's wheel ships: its functions.

Reference: the CVODE user guide, https://sundials.readthedocs.io/en/latest/cvode (C interface, version 7).
Vectors are read through `N_VGetArrayPointer`, so that nothing depends on how SUNDIALS lays its structures out.
"""

from __future__ import annotations

import ctypes
import sys
from ctypes import byref, c_int, c_void_p
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from contactbench.peers.abi import signature

#: the major version whose interface is written below
MAJOR = 7
ADAMS, BDF = 1, 2
#: integration tasks
NORMAL, ONE_STEP = 1, 2
#: results of CVode
TOO_MUCH_WORK = -1
#: what the library's file may be called
PATTERNS = ("libsundials_cvode-*", "libsundials_cvode.so*", "libsundials_cvode*.dylib")
#: the functions used, as `abi.signature` reads them; n is the type SUNDIALS counts with
FUNCTIONS = {
    "SUNDIALSGetVersionNumber": "ippppi",
    "SUNContext_Create": "iip",
    "SUNContext_ClearErrHandlers": "ip",
    "SUNContext_Free": "ip",
    "N_VMake_Serial": "pnpp",
    "N_VGetArrayPointer": "pp",
    "N_VDestroy": "vp",
    "SUNDenseMatrix": "pnnp",
    "SUNDenseMatrix_Data": "pp",
    "SUNMatDestroy": "vp",
    "SUNLinSol_Dense": "pppp",
    "SUNLinSolFree": "ip",
    "CVodeCreate": "pip",
    "CVodeInit": "ippdp",
    "CVodeReInit": "ipdp",
    "CVodeSStolerances": "ipdd",
    "CVodeSetUserData": "ipp",
    "CVodeSetLinearSolver": "ippp",
    "CVodeSetJacFn": "ipp",
    "CVodeSetMaxNumSteps": "ipl",
    "CVodeSetMinStep": "ipd",
    "CVodeSetMaxStep": "ipd",
    "CVodeSetStopTime": "ipd",
    "CVode": "ipdppi",
    "CVodeGetDky": "ipdip",
    "CVodeGetNumSteps": "ipp",
    "CVodeGetNumRhsEvals": "ipp",
    "CVodeGetNumJacEvals": "ipp",
    "CVodeGetNumErrTestFails": "ipp",
    "CVodeGetNumStepSolveFails": "ipp",
    "CVodeFree": "vp",
}


class Unavailable(Exception):
    """Why the library cannot be used."""


def _library_file() -> Path:
    """Return where CVODE is: beside the package in a repaired wheel, or among the environment's libraries."""
    package = find_spec("sksundae")
    if package is None or package.origin is None:
        raise Unavailable("scikit-sundae is not installed")
    folder = Path(package.origin).parent
    places = (folder.parent / "scikit_sundae.libs", folder / ".dylibs", Path(sys.prefix) / "lib")
    for place in places:
        for pattern in PATTERNS:
            for found in sorted(place.glob(pattern)):
                return found
    raise Unavailable(f"scikit-sundae's CVODE library is not in {', '.join(map(str, places))}")


class Library:
    """The functions of the library, with their types, as attributes."""

    def __init__(self) -> None:
        path = _library_file()
        from sksundae._cy_common import config  # how the library was built

        if config["SUNDIALS_FLOAT_TYPE"] != "double":
            raise Unavailable(f"SUNDIALS was built with {config['SUNDIALS_FLOAT_TYPE']} numbers")
        index = "i" if config["SUNDIALS_INT_TYPE"] == "int" else "q"
        try:
            handle = ctypes.CDLL(str(path))
            for name, word in FUNCTIONS.items():
                function = getattr(handle, name)
                function.restype, function.argtypes = signature(word.replace("n", index))
                setattr(self, name, function)
        except (OSError, AttributeError) as error:
            raise Unavailable(f"{path.name}: {error}") from error
        version, label = [c_int(), c_int(), c_int()], ctypes.create_string_buffer(16)
        self.SUNDIALSGetVersionNumber(*map(byref, version), label, len(label))
        if version[0].value != MAJOR:
            found = ".".join(str(part.value) for part in version)
            raise Unavailable(f"SUNDIALS {found}: its C interface is known for version {MAJOR} only")

    def __getattr__(self, name: str) -> Any:
        raise AttributeError(name)  # the functions declared above; for the type checker

    def address(self, name: str) -> int:
        """Return where a function is."""
        return ctypes.cast(getattr(self, name), c_void_p).value or 0


@cache
def library() -> Library | Unavailable:
    """Return the library, or why there is none."""
    try:
        return Library()
    except Unavailable as why:
        return why

"""``contactbench claim``: one claim of the paper, or beyond it, measured."""

from __future__ import annotations

import argparse
import json
from typing import Any

from contactbench.cli.parsing import Command


def claim(arguments: argparse.Namespace) -> int:
    """Measure one claim of the ledger and print its row."""
    from contactbench.claims import CLAIMS

    row = CLAIMS[arguments.id.upper()].row()
    print(json.dumps(row, allow_nan=False) if arguments.json else readable(row))
    return 0 if row["status"] == "ok" else 1


def readable(row: dict[str, Any]) -> str:
    """Return a claim's row as text: the claim, each measurement on a line, the verdict, the correction."""
    from contactbench.results.schema import SEPARATOR

    lines = [f"{row['id']}  {row['where']}", f"claim       {row['claim']}"]
    lines += [f"scene       {row['scene']}", f"method      {row['method']}"]
    if row["status"] != "ok":
        return "\n".join([*lines, f"status      {row['status']}: {row['message']}"])
    lines += [f"measured    {item}" for item in row["evidence"].split(SEPARATOR)]
    lines.append(f"verdict     {row['verdict']}")
    if row["correction"]:
        lines.append(f"correction  {row['correction']}")
    lines += [f"measured    {item}" for item in row.get("corrected_evidence", "").split(SEPARATOR) if item]
    return "\n".join(lines)


def add(command: Command) -> None:
    """Add the command and its options."""
    examples = "examples:\n  contactbench claim C25\n  contactbench claim C07 --json | jq -r .verdict"
    ledger = command("claim", claim, "measure one claim of the ledger", examples)
    ledger.add_argument("id", help="C01 to C42, X01, X02, in either case (contactbench list claims)")
    ledger.add_argument("--json", action="store_true", help="print one JSON object")

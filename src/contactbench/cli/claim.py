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


#: columns of the ledger in the order they are printed, and what they are called there
LABELS = {name: name for name in ("id", "where", "claim", "scene", "method", "message")}
LABELS |= {"evidence": "measured", "verdict": "verdict", "correction": "correction"}
LABELS |= {"corrected_evidence": "measured"}


def readable(row: dict[str, Any]) -> str:
    """Return a claim's row as text, each measurement on a line."""
    from contactbench.results.schema import SEPARATOR

    parts = ((label, item) for name, label in LABELS.items() for item in row.get(name, "").split(SEPARATOR))
    return "\n".join(f"{label:11} {item}" for label, item in parts if item)


def add(command: Command) -> None:
    """Add the command and its options."""
    examples = "examples:\n  contactbench claim C25\n  contactbench claim C07 --json | jq -r .verdict"
    ledger = command("claim", claim, "measure one claim of the ledger", examples)
    ledger.add_argument("id", help="C01 to C42, X01, X02, in either case (contactbench list claims)")
    ledger.add_argument("--json", action="store_true", help="print one JSON object")

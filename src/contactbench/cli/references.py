"""``contactbench references``: what the stored truth is."""

from __future__ import annotations

import argparse

from contactbench.cli.parsing import Command
from contactbench.errors import BadInput


def references(_: argparse.Namespace) -> int:
    """Print the stored references, their digits and their digests."""
    from contactbench.truth import frozen_folder, manifest

    folder = frozen_folder()
    if folder is None:
        raise BadInput("no stored references in this installation; they are computed live")
    for name, entry in manifest(folder).items():
        second = entry["second_engine"]["agreeing_digits"]
        digits = f"{entry['digits']} digits stored, {second} confirmed by a second engine"
        print(f"{name:24} {digits}, sha256 {entry['sha256'][:16]}…")
    return 0


def add(command: Command) -> None:
    """Add the command."""
    command("references", references, "the stored references, their digits and digests")

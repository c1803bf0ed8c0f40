"""Compare the size of the repository with its budgets: ``python bench/sizes.py`` (needs git and ruff).

Python is counted after plain formatting, without ``# fmt: skip``.  Budgets, and the rooms that may exceed theirs for
now with the reason, are in sizes.toml.  Exit status 1 where anything else is too large.
"""

import re
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
SKIP = re.compile(r" *# fmt: (?:skip|off|on).*")
SIZES = tomllib.loads((ROOT / "bench/sizes.toml").read_text(encoding="utf-8"))


def tracked(*patterns: str) -> list[Path]:
    """Return the files that git tracks under some paths."""
    command = ["git", "-C", str(ROOT), "ls-files", "-z", "--", *patterns]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
    return [path for name in names[:-1] if (path := ROOT / name).exists()]


def lines_of_python() -> tuple[dict[Path, int], int]:
    """Return the lines of every file after plain formatting, and how often formatting is switched off."""
    skips = 0
    with tempfile.TemporaryDirectory() as folder:
        copies = {path: Path(folder) / f"{n}.py" for n, path in enumerate(tracked("*.py"))}
        for path, copy in copies.items():
            text, found = SKIP.subn("", path.read_text(encoding="utf-8"))
            copy.write_text(text, encoding="utf-8")
            skips += found
        subprocess.run(["ruff", "format", "-q", "--isolated", "--line-length=110", folder], check=True)
        return {path: len(copy.read_text().splitlines()) for path, copy in copies.items()}, skips


def sizes() -> Counter[str]:
    """Return the size of everything that has a budget, by its name."""
    lines, skips = lines_of_python()
    found: Counter[str] = Counter({"fmt: skip": skips})
    for room, paths in SIZES["rooms"].items():
        inside = [ROOT / path for path in paths]
        found[room] = sum(
            n for path, n in lines.items() if any(path == i or i in path.parents for i in inside)
        )
    for name, paths in SIZES["kilobytes"].items():
        found[name] = round(sum(path.stat().st_size for path in tracked(*paths)) / 1000)
    for name, paths in SIZES["lines"].items():
        found[name] = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in tracked(*paths))
    for name, paths in SIZES["files"].items():
        found[name] = len(tracked(*paths))
    return found


def main() -> int:
    found, budgets, allowed = sizes(), SIZES["budgets"], SIZES["over"]
    wrong = []
    for name, most in budgets.items():
        size, note = found[name], allowed.get(name, {})
        print(f"{size:>9,} of {most:>7,}  {name}" + (f": {note['reason']}" if size > most and note else ""))
        if size > max(most, note.get("most", 0)):
            wrong.append(f"{name} is too large")
        elif note and size <= most:
            wrong.append(f"{name} is within its budget: take it out of [over]")
    print(*(wrong or ["no room is larger than its budget but for those named"]), sep="\n")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())

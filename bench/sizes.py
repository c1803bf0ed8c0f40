"""How large is the repository, and what may it be?  ``python bench/sizes.py`` (needs git and ruff).

Python is counted after plain formatting, without ``# fmt: skip``.  Exit status 1 where a budget is exceeded.
"""

import re
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
SKIP = re.compile(r" *# fmt: (?:skip|off|on).*")
BUDGETS = {
    "lines of src": 25_800,
    "lines of bench": 700,
    "lines of tests": 13_900,
    "fmt: skip": 20,
    "lines of README.md": 150,
    "lines of results/README.md": 120,
    "kB of results": 8_000,
}


def tracked(pattern: str) -> list[Path]:
    command = ["git", "-C", str(ROOT), "ls-files", "-z", pattern]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split("\0")
    return [path for name in names[:-1] if (path := ROOT / name).exists()]


def sizes() -> Counter[str]:
    found: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as folder:
        copies = {path: Path(folder) / f"{n}.py" for n, path in enumerate(tracked("*.py"))}
        for path, copy in copies.items():
            text, skips = SKIP.subn("", path.read_text(encoding="utf-8"))
            copy.write_text(text, encoding="utf-8")
            found["fmt: skip"] += skips
        subprocess.run(["ruff", "format", "-q", "--isolated", "--line-length=110", folder], check=True)
        for path, copy in copies.items():
            package = path.parent.relative_to(ROOT).parts[:3]
            for depth in {1, len(package)} - {0}:
                found[f"lines of {'/'.join(package[:depth])}"] += len(copy.read_text().splitlines())
    for path in tracked("src/*.toml"):
        found["lines of data in src (TOML)"] += len(path.read_text(encoding="utf-8").splitlines())
    for path in tracked("*.md"):
        found[f"lines of {path.relative_to(ROOT)}"] = len(path.read_text(encoding="utf-8").splitlines())
    found["kB of results"] = round(sum(path.stat().st_size for path in tracked("results")) / 1000)
    return found


found = sizes()
for name, size in sorted(found.items()):
    print(f"{size:>10,} {name}" + (f" (of {BUDGETS[name]:,})" if name in BUDGETS else ""))
over = [name for name, most in BUDGETS.items() if found[name] > most]
print("too large: " + ", ".join(over) if over else "within every budget")
sys.exit(bool(over))

"""The interactive page: error against cost, one HTML file that fetches nothing.

``mkdocs build`` adds it to the site as explore.html, made of results/.  By itself::

    python docs/page/page.py results explore.html
"""

from __future__ import annotations

import argparse
import colorsys
import json
from pathlib import Path
from typing import Any, NamedTuple

import pandas as pd
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from plotly.offline import get_plotlyjs

import contactbench as cb
from contactbench.methods.base import ENGINES
from contactbench.report.curves import FLOOR, by_method, cheapest, choose
from contactbench.report.look import DASHES, FAMILIES, look

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
NAME = "explore.html"
#: columns of times.csv, and those of both that the page shows
TIME = ["least_s", "compile_s", "first_s"]
SHOWN = [
    "scene",
    "method",
    "error",
    "least_s",
    "evaluations",
    "control",
    "setting",
    "engine",
    "steps",
    "rejected",
]
SHOWN += ["jacobians", "compile_s", "first_s", "status", "message"]
#: matplotlib's markers as plotly names them
NAMES = "circle square diamond diamond-tall star pentagon triangle-down triangle-up triangle-left triangle-right x-thin"
SYMBOLS = dict(
    zip("osDd*pv^<>xXPhH8", [*NAMES.split(), "x", "cross", "hexagon", "hexagon2", "octagon"], strict=True)
)
#: plotly's dashes are pixels, ours are line widths
WIDTH = 2


class Cost(NamedTuple):
    """A horizontal axis; engines : "compiled" or "callbacks", the kind whose runs are compared; "": all of them."""

    name: str
    column: str
    engines: str
    axis: str


COSTS = (
    Cost("compiled time", "least_s", "compiled", "time of a solve, compiled"),
    Cost("time with Python callbacks", "least_s", "callbacks", "time of a solve, with Python callbacks"),
    Cost("evaluations", "evaluations", "", "evaluations of the right-hand side"),
)


def table(results: Path) -> pd.DataFrame:
    """Return the runs to the end alone, with their times; attrs["columns"] says what a column means."""
    runs, times = cb.results("runs", results), cb.results("times", results)
    key = ["scene", "method", "engine", "control", "setting", "saved"]
    rows = runs[runs["saved"] == 1].merge(times[[*key, *TIME]], how="left", on=key)
    rows.attrs["columns"] = times.attrs["columns"] | runs.attrs["columns"]
    return rows


def dark(color: str) -> str:
    """Return a colour for a dark ground: the same hue, the lighter the darker it is."""
    red, green, blue = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    hue, lightness, saturation = colorsys.rgb_to_hls(red, green, blue)
    turned = colorsys.hls_to_rgb(hue, 0.92 - 0.6 * lightness, saturation)
    return "#" + "".join(f"{round(255 * part):02x}" for part in turned)


def style(method: str, family: str) -> dict[str, Any]:
    """Return how plotly draws a method; contact markers are filled, all others hollow."""
    own = look(method, family)
    dash = ",".join(f"{WIDTH * length}px" for length in DASHES.get(own.order or 0, ())) or "solid"
    symbol = SYMBOLS[own.marker] + ("" if own.family == "contact" else "-open")
    return {"family": own.family, "light": own.color, "dark": dark(own.color), "dash": dash, "symbol": symbol}


def preset(rows: pd.DataFrame, cost: Cost) -> list[str]:
    """Return the methods that are chosen at first: those that a figure of the documents shows."""
    fits = rows["engine"].map(ENGINES).eq(cost.engines) if cost.engines else True
    drawn = rows[(rows["status"] == "ok") & rows["error"].notna() & rows[cost.column].notna() & fits]
    return choose(by_method(drawn, "error", cost.column), cheapest)


def content(rows: pd.DataFrame) -> dict[str, Any]:
    """Return all that the page shows, as plain data."""
    shown = rows[SHOWN].astype(object)
    families = rows.drop_duplicates("method").set_index("method")["family"]
    methods = {str(name): style(str(name), str(family)) for name, family in families.items()}
    known = cb.SCENES
    return {
        "costs": [cost._asdict() for cost in COSTS],
        "engines": ENGINES,
        "families": [*FAMILIES],
        "floor": FLOOR,
        "methods": methods,
        "scenes": {name: known[name].about if name in known else "" for name in rows["scene"].unique()},
        "presets": {
            name: [preset(own, cost) for cost in COSTS] for name, own in rows.groupby("scene", sort=False)
        },
        "meanings": {name: rows.attrs["columns"][name] for name in shown},
        "rows": {name: values.where(values.notna(), None).tolist() for name, values in shown.items()},
    }


def html(data: dict[str, Any]) -> str:
    """Return the page: the template with its style, its script, plotly and the data in it."""
    parts = {name: (HERE / name).read_text(encoding="utf-8") for name in ("page.css", "page.js")}
    # within a script neither an end tag nor a comment may begin
    parts["data"] = json.dumps(data, ensure_ascii=False, allow_nan=False).replace("<", "\\u003c")
    parts["plotly"] = get_plotlyjs()
    text = (HERE / "page.html").read_text(encoding="utf-8")
    for name, part in parts.items():
        text = text.replace(f"{{{{ {name} }}}}", part)
    return text


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add the page to the site."""
    files.append(File.generated(config, NAME, content=html(content(table(ROOT / "results")))))
    return files


def main() -> None:
    parser = argparse.ArgumentParser(description="Write the interactive page of a folder of results.")
    parser.add_argument("results", type=Path, help="folder with runs.csv and times.csv")
    parser.add_argument("page", type=Path, help="file to write")
    given = parser.parse_args()
    given.page.write_text(html(content(table(given.results))), encoding="utf-8")


if __name__ == "__main__":
    main()

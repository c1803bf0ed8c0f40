"""The HTML page: what it says is what the tables say; and it works in a real browser, wide and narrow."""

from __future__ import annotations

import json
import re
import shutil
from html.parser import HTMLParser

import pandas as pd
import pytest

from cases import REPOSITORY
from contactbench.report import figures, page
from contactbench.results.schema import (
    CLAIMS_TABLE,
    CONVERGENCE,
    LAWS_TABLE,
    TABLES,
    WORK_PRECISION,
    Table,
    read,
)

RESULTS = REPOSITORY / "results"
VOID = {"meta", "link", "br", "wbr", "img", "input", "hr", "path", "use"}


def tables(**changed):
    return {name: read(table, RESULTS) for name, table in TABLES.items()} | changed


@pytest.fixture(scope="module")
def text():
    return page.page(tables(), json.loads((RESULTS / "environment.json").read_text()))


class Document(HTMLParser):
    """Checks that every element is closed where it should be; collects ids, links and the payload."""

    def __init__(self, text):
        super().__init__(convert_charrefs=True)
        self.open, self.wrong, self.ids, self.links, self.payload = [], [], [], [], ""
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        values = dict(attributes)
        self.ids += [values["id"]] if "id" in values else []
        self.links += [v for k, v in attributes if k in ("href", "src", "action", "poster", "srcset")]
        if tag not in VOID:
            self.open.append((tag, values.get("id")))

    def handle_startendtag(self, tag, attributes):
        self.handle_starttag(tag, attributes)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        if not self.open or self.open[-1][0] != tag:
            self.wrong.append((tag, self.getpos()))
        else:
            self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] == ("script", "data"):
            self.payload += data


def test_the_page_is_well_formed_and_its_links_stay_inside(text):
    document = Document(text)
    assert not document.wrong
    assert not document.open
    assert len(set(document.ids)) == len(document.ids)
    inside = [link[1:] for link in document.links if link.startswith("#")]
    assert inside
    assert set(inside) <= set(document.ids)
    assert {link for link in document.links if not link.startswith("#")} == {"data:,"}


def test_the_page_needs_no_network_and_is_small(text):
    assert len(text.encode()) < 2_000_000
    addresses = set(re.findall(r"https?://[^\s\"'<)]*", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # a name, not an address
    for fetching in ("@import", "url(", "fetch(", "XMLHttpRequest", "WebSocket", "import("):
        assert fetching not in text
    assert "default-src 'none'" in text  # and the browser is told to refuse


def test_the_figures_have_every_point_of_the_table(text):
    payload = json.loads(Document(text).payload)
    work = read(WORK_PRECISION, RESULTS)
    drawn = work[work["track"].isin(["fixed", "adaptive"]) & (work["status"] == "ok")]
    shown = pd.DataFrame(
        [(scene, *row) for scene, rows in payload["points"].items() for row in rows],
        columns=["scene", *payload["columns"]],
    )
    key = ["scene", "method", "engine", "setting"]
    both = shown.merge(drawn, on=key, suffixes=("", "_table"))
    assert len(both) == len(shown) == len(drawn)
    for name in ("solution_error", "time_median_s", "rhs_equivalents"):
        assert (abs(both[name] / both[f"{name}_table"] - 1) < 1e-3).all()  # four digits


@pytest.mark.parametrize("table", [WORK_PRECISION, LAWS_TABLE, CONVERGENCE], ids=lambda t: t.name)
def test_every_method_and_scene_of_a_table_is_on_the_page(text, table):
    frame = read(table, RESULTS)
    for name in {*frame["scene"], *frame["method"]} - {"limit-c"}:
        assert name in text or name.replace("_", "_<wbr>") in text


def test_every_claim_has_its_verdict(text):
    frame = read(CLAIMS_TABLE, RESULTS)
    for _, row in frame.iterrows():
        verdict = row["verdict"].replace(", ", "-")
        assert re.search(rf">{row['id']}</th><td[^>]*><span class=\"verdict {verdict}\">", text), row["id"]


def test_equal_tables_give_an_equal_page(text):
    again = page.page(tables(), json.loads((RESULTS / "environment.json").read_text()))
    assert again == text


def test_a_partial_run_gives_the_sections_it_has():
    empty = {name: frame.iloc[:0] for name, frame in tables().items()}
    work = read(WORK_PRECISION, RESULTS)
    part = work[(work["scene"] == "particle") & (work["method"] == "rk4")]
    document = Document(page.page(empty | {"work_precision": part}, {}))
    assert {"headline", "cost", "environment"} <= set(document.ids)
    assert not {"laws", "convergence", "claims"} & set(document.ids)
    assert Document(page.page(empty, {})).ids.count("environment") == 1


def test_what_a_row_says_cannot_break_the_page():
    work = read(WORK_PRECISION, RESULTS)
    evil = work[work["scene"] == "particle"].head(3).assign(
        method="</script><b>", status=["ok", "failed", "ok"], message="<img src=x>"
    )  # fmt: skip
    document = Document(page.page(tables(work_precision=evil), {}))
    assert not document.wrong
    assert "x" not in document.links
    assert json.loads(document.payload)["points"]["particle"][0][0] == "</script><b>"


def test_colours_stand_out_from_the_dark_page_and_markers_are_matplotlibs():
    for method in figures.STYLES:
        look = page.look(method)
        lighter = page.luminance(look["dark"]) + 0.05
        assert lighter / (page.luminance(page.DARK_PAPER) + 0.05) >= page.CONTRAST
        assert look["light"].lower() == figures.STYLES[method][0].lower()
    assert page.outline("s") == "M-0.5 0.5L0.5 0.5L0.5 -0.5L-0.5 -0.5Z"
    assert page.outline("o").count("C") == 8
    assert page.luminance("#ffffff") == pytest.approx(1)
    assert page.luminance("#777777") == pytest.approx(0.184, abs=1e-3)  # 4.48 against white, WCAG's example


def test_the_stability_map_tells_every_ending_apart():
    rows = [
        {"scene": "stiff", "method": "rk4", "engine": "jax", "setting": f"step={h}", "status": status,
         "message": why, "solution_error": error}
        for h, status, why, error in (
            (0.8, "diverged", "left the scene", float("nan")), (0.4, "ok", "", 3.0), (0.2, "ok", "", 2e-5),
            (0.1, "budget", "too long", float("nan")), (0.05, "ok", "", 0.0), (0.02, "ok", "", float("nan")),
        )
    ]  # fmt: skip
    (row,) = page.stability_map(pd.DataFrame(rows))["rows"]
    (cell,) = row["cells"]
    assert [(m["text"], m["look"]) for m in cell["marks"]] == [
        ("D", "bad"), ("", "d0"), ("", "d2"), ("B", "bad"), ("", "d6"), ("?", "unknown"),
    ]  # fmt: skip
    assert cell["marks"][0]["says"] == "rk4 on stiff, step=0.8: diverged (left the scene)"
    assert cell["best"] == "0e+00"
    truly = pd.Series(rows[0] | {"blow_up_time": 1.25})
    assert page.mark(truly)["look"] == "right"
    assert page.mark(truly)["says"].endswith("so does the true motion, at t = 1.25")
    assert len(set(page.LETTERS.values())) == len(page.LETTERS)


def test_a_table_unknown_to_the_page_is_shown_with_its_meanings(monkeypatch):
    columns = {"method": "name of the method", "largest": "largest stable step"}
    monkeypatch.setitem(TABLES, "limits", Table("limits", "where it breaks", columns, key=("method",)))
    frame = pd.DataFrame({"method": ["rk4", "new"], "largest": [2.7853, 1.5e-7], "run_id": "r", "schema": 1})
    text = page.page(tables(limits=frame), {})
    assert page.whole_sheet("limits", pd.concat([frame] * 6000)) is None  # left to its CSV
    section = text[text.index('<section id="limits">') :].partition("</section>")[0]
    assert "Where it breaks." in section
    assert 'title="largest stable step"' in section
    assert 'data-v="2.7853">2.785<' in section
    assert 'data-v="1.5e-07">1.5e-07<' in section
    assert "run_id" not in section


# -- in a browser ----------------------------------------------------------------------------------
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
browser = pytest.mark.skipif(
    not (CHROMIUM and DRIVER), reason="no chromium and chromedriver here (Debian: chromium, chromium-driver)"
)
QUIET = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
WIDE, NARROW = (1280, 900), (390, 844)


@pytest.fixture(scope="module")
def chrome(text, tmp_path_factory):
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(text, encoding="utf-8")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in QUIET:
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.address = path.as_uri()
    yield driver
    driver.quit()


def opened(chrome, size=WIDE, scheme="light"):
    """A fresh view of the page."""
    width, height = size
    screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    chrome.get(chrome.address)
    return chrome


def find(chrome, selector):
    return chrome.find_elements("css selector", selector)


def expected_points(scene, y, engines=None):
    """What a figure should show, from the table."""
    work = read(WORK_PRECISION, RESULTS)
    part = work[
        (work["scene"] == scene) & (work["status"] == "ok") & work["track"].isin(["fixed", "adaptive"])
    ]
    if engines:
        return part[part["engine"].isin(engines)]
    first = part.groupby("method")["engine"].transform("first")
    return part[part["engine"] == first]


@browser
@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["desktop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_without_an_error_and_scrolls_in_one_direction(chrome, size, scheme):
    opened(chrome, size, scheme)
    assert chrome.get_log("browser") == []
    wide, view = chrome.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= view == size[0]
    paper = chrome.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert paper == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(16, 20, 24)")
    assert all(0 < plot.size["width"] <= size[0] for plot in find(chrome, ".plot svg"))
    # what is wider than the screen scrolls in its own box
    outside = """return [...document.querySelectorAll("main *, header *")].filter((e) => e.checkVisibility()
        && !e.closest(".box, .unseen, .plot, .symbols") && e.getBoundingClientRect().right > innerWidth + 1).length"""
    assert chrome.execute_script(outside) == 0


@browser
def test_every_scene_can_be_chosen_and_draws_all_its_points(chrome):
    from selenium.webdriver.support.select import Select

    opened(chrome)
    for scene in dict.fromkeys(read(WORK_PRECISION, RESULTS)["scene"]):
        Select(find(chrome, "#cost select.scene")[0]).select_by_visible_text(scene)
        time, evaluations = (
            len(plot.find_elements("css selector", ".dot")) for plot in find(chrome, ".plot")
        )
        assert time == len(expected_points(scene, "time_median_s", ("jax", "llvm")))
        assert evaluations == len(expected_points(scene, "rhs_equivalents"))
        shown = [s.get_attribute("data-scene") for s in find(chrome, ".per-scene") if s.is_displayed()]
        assert set(shown) == {scene}
        assert (
            find(chrome, "#laws select.scene")[0].get_attribute("value") == scene
        )  # one choice for the page
    find(chrome, "#tracks button")[1].click()
    time = find(chrome, ".plot")[0].find_elements("css selector", ".dot")
    assert len(time) == len(expected_points(scene, "time_median_s", ("python", "c+python")))
    assert "python" in find(chrome, "#time-title")[0].text


@browser
def test_methods_are_switched_by_mouse_and_by_keyboard(chrome):
    from selenium.webdriver.common.keys import Keys

    opened(chrome)

    def lines(method):
        return len(find(chrome, f'.line[data-method="{method}"]'))

    key = find(chrome, '.key[value="rk4"]')[0]
    assert lines("rk4") == 2
    key.click()
    assert (lines("rk4"), key.get_attribute("aria-pressed")) == (0, "false")
    key.send_keys(Keys.SPACE)
    assert (lines("rk4"), key.get_attribute("aria-pressed")) == (2, "true")
    find(chrome, '[data-show="none"]')[0].click()
    assert not find(chrome, ".line")
    find(chrome, '[data-show="own"]')[0].click()
    drawn = {line.get_attribute("data-method") for line in find(chrome, ".line")}
    assert drawn
    assert all(method.startswith("contact-") for method in drawn)
    find(chrome, '[data-show="all"]')[0].click()
    assert lines("rk4") == 2
    assert chrome.get_log("browser") == []


@browser
def test_points_tell_their_row_to_mouse_and_keyboard(chrome):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    opened(chrome)
    figure = find(chrome, ".plot svg")[0]
    chrome.execute_script("arguments[0].scrollIntoView({block: 'center'})", figure)
    part = expected_points("particle", "time_median_s", ("jax", "llvm"))
    row = part[part["method"] == "diffrax-kvaerno5"].iloc[-1]  # far from the others
    dot = find(chrome, '.plot .line[data-method="diffrax-kvaerno5"] .dot')[
        len(part[part["method"] == "diffrax-kvaerno5"]) - 1
    ]
    ActionChains(chrome).move_to_element(dot).perform()
    (tip,) = (t for t in find(chrome, ".tip") if t.is_displayed())
    for said in (
        "diffrax-kvaerno5",
        row["engine"],
        row["setting"],
        page.duration(row["time_median_s"]),
        "ok",
    ):
        assert said in tip.text
    assert f"{row['solution_error']:.1e}".replace("e-0", "e-") in tip.text
    assert page.count(row["evaluations"]) in tip.text
    lit = {line.get_attribute("data-method") for line in find(chrome, ".line.lit")}
    assert lit == {"diffrax-kvaerno5"}
    ActionChains(chrome).move_to_element(find(chrome, "h2")[0]).perform()
    assert not any(t.is_displayed() for t in find(chrome, ".tip"))

    spoken = find(chrome, "#spoken")[0]
    said = []
    for press in (Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_DOWN):
        figure.send_keys(press)
        said.append(spoken.get_attribute("textContent"))
    assert len(set(said)) == 3
    first, second, other = (line.partition(",")[0] for line in said)
    assert first == second != other  # right: along the curve; down: to another one
    figure.send_keys(Keys.ESCAPE)
    assert not any(t.is_displayed() for t in find(chrome, ".tip"))


SORTED = """
const table = arguments[0];
return [...table.tHead.rows[0].cells].flatMap((head, column) => [1, 2].map(() => {
  head.querySelector("button").click();
  return [head.getAttribute("aria-sort"), table.querySelectorAll("[aria-sort]").length,
    [...table.tBodies[0].rows].map(({ cells }) =>
      "v" in cells[column].dataset ? Number(cells[column].dataset.v) : cells[column].textContent.trim())];
}));
"""


@browser
def test_every_table_sorts_by_every_column_with_blanks_last(chrome):
    opened(chrome)
    for table in find(chrome, "table.sortable"):  # shown or not: the heads are clicked by script
        clicks = chrome.execute_script(SORTED, table)
        assert [direction for direction, _, _ in clicks[:2]] == ["ascending", "descending"]
        for direction, sorted_columns, values in clicks:
            assert sorted_columns == 1
            numbers = [v for v in values if not isinstance(v, str)]
            assert numbers == sorted(numbers, reverse=direction == "descending")
            blank = [v in ("", "—") for v in values]
            assert blank == sorted(blank)


@browser
def test_tabs_and_verdicts_choose_and_paper_shows_everything(chrome):
    opened(chrome)
    tabs, panels = find(chrome, '[role="tab"]'), find(chrome, "[data-tab]")
    assert [p.is_displayed() for p in panels] == [True, False, False]
    tabs[2].click()
    assert [p.is_displayed() for p in panels] == [False, False, True]
    claims = read(CLAIMS_TABLE, RESULTS)
    find(chrome, '#verdicts button[value="holds"]')[0].click()
    shown = [row for row in find(chrome, "#claims tbody tr") if row.is_displayed()]
    assert len(shown) == (claims["verdict"] != "holds").sum() > 0
    chrome.execute_script("dispatchEvent(new Event('beforeprint'))")
    assert not find(chrome, "details:not([open])")
    chrome.execute_script("dispatchEvent(new Event('afterprint'))")
    assert not find(chrome, "details[open]")
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    assert all(p.is_displayed() for p in panels)
    assert not find(chrome, "nav")[0].is_displayed()
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})

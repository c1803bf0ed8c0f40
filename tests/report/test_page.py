"""The HTML page: what it says is what the rooms say; and it works in a real browser, wide and narrow."""

from __future__ import annotations

import json
import math
import os
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser

import pytest

from contactbench.report import page
from contactbench.report.cells import Head, Mark, View, number, word
from contactbench.report.drawing import Axis, Curve, Figure, Heat, Note, Panel, Span
from contactbench.report.look import METHODS, ROLES
from contactbench.report.page import words
from contactbench.report.rooms import Finding, Room, Section, Text

VOID = {"meta", "link", "br", "wbr", "img", "input", "hr", "path", "use"}
NAMES = ("contact-strang", "rk4", "heyoka-taylor", "my-own")


# -- rooms made up for the purpose -------------------------------------------------------------------
def curves(shift=0.0):
    errors = (1e-2, 1e-4, 1e-6, 1e-8)
    return tuple(
        Curve(
            errors, tuple((k + 1 + shift) * e**-0.2 for e in errors), label=name, method=name,
            low=tuple(0.9 * (k + 1) * e**-0.2 for e in errors), high=tuple(1.1 * (k + 1) * e**-0.2 for e in errors),
            hints=tuple(f"{name} at error {e:g}" for e in errors),
            also=(("drift", tuple(e**2 for e in errors)),),
        )
        for k, name in enumerate(NAMES)
    )  # fmt: skip


def work(name):
    drift = Axis(r"drift of $e^{\int\Gamma'} J$", "log", key="drift")
    x = Axis("error", "log", inverted=True, key="error", others=(drift,))
    y = Axis("time, µs", "log")
    flat = Panel(
        "time", x, y, curves(), spans=(Span("x", 1e-9, 1e-7, "round-off"),), notes=(Note(1e-5, 9.0, "here"),)
    )
    turn = tuple(k / 10 for k in range(63))
    ring = Curve(tuple(map(math.cos, turn)), tuple(map(math.sin, turn)), "flow", role="flow", z=(0.0,) * 63)
    ball = Panel("momentum", Axis("M₁"), Axis("M₂"), (ring,), z=Axis("M₃"), sphere=True)
    grid = (0.0, 0.5, 1.0)
    heat = Heat(grid, grid, ((-1.0, 0.0, 1.0),) * 3, "growth rate")
    line = Curve(grid, (1.0, 0.5, 0.0), "criterion", role="criterion", markers=False)
    return Figure(
        name, f"cost on **{name}**", (flat, ball, Panel("growth", Axis("d₁"), Axis("d₂"), (line,), heat=heat))
    )


def contest():
    """A curve that is not the best of its family, one that leaves every range, and an axis that ends."""
    figure = work("central")
    flat = figure.panels[0]
    others = (
        Curve((1e-2, 1e-4), (3.0, 4.0), "grey", "grey", muted=True),
        Curve((1e-2, 1e-4, 1e-6), (1.0, 1e40, 2.0), "far", "far"),
    )
    ended = replace(
        flat, y=replace(flat.y, within=(None, 1e3)), curves=(*flat.curves, *others), remark="beyond: far"
    )
    return replace(figure, panels=(ended, *figure.panels[1:]))


COSTS = View(
    "costs", "Costs", "The **cheapest** is marked; see [laws](laws.md) and `costs.csv`.",
    (
        Head("method", words=True), Head("1e-03", group="error"),
        Head("1e-06", "cost there", group="error"), Head("kept"),
    ),
    tuple(
        (
            word(name), number(k * 1e-6, "{:.1e}".format, Mark.best if not k else None),
            number(None, str), word("≤", Mark.kept),
        )
        for k, name in enumerate(NAMES)
    ),
    "costs.csv",
)  # fmt: skip
ROWS = View(
    "rows", "All rows", "every one", (Head("method"), Head("n")),
    tuple((word(NAMES[k % 4]), number(math.inf if k == 9 else (k * 7) % 50, str)) for k in range(50)), detail=True,
)  # fmt: skip


def room(name="work_precision", title="Cost", file="work_precision.md"):
    return Room(name, title, "cost", 1, ("work_precision",), lambda frames: (), document=file)


def rooms(**changed):
    parts = (
        Text("Dimensionless.", ("one", "**two**")), COSTS,
        Section("particle", (work("particle"), ROWS), choice="scene"),
        Section("central", (contest(),), choice="scene"),
        Section("After", (Text("the end"),)),
    )  # fmt: skip
    finding = Finding("structure", "Structure", "All but **one** keep it.", "28 rows", ("`rk4` on particle",))
    laws = page.Said(room("laws", "Laws", "laws.md"), (Text("see [cost](work_precision.md)"),), ())
    return [page.Said(room(**changed), parts, (finding,)), laws]


RUNS = [{"commit": "abc", "processor": "x < y"}]


@pytest.fixture(scope="module")
def text():
    return page.page(rooms(), RUNS)


class Document(HTMLParser):
    """What is opened and closed, ids, links, and the data of the script."""

    def __init__(self, text):
        super().__init__()
        self.open, self.wrong, self.ids, self.links, self.payload, self.text = [], [], [], [], "", ""
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[name] for name in ("href", "src") if name in given]
        if tag not in VOID:
            self.open.append((tag, given))

    def handle_endtag(self, tag):
        if tag in VOID:
            return
        if not self.open or self.open[-1][0] != tag:
            self.wrong.append(tag)
        else:
            self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1][1].get("id") == "data":
            self.payload += data
        self.text += data


def test_the_page_is_well_formed_and_its_links_stay_inside(text):
    document = Document(text)
    assert not document.wrong
    assert not document.open
    assert len(set(document.ids)) == len(document.ids)
    inside = [link[1:] for link in document.links if link.startswith("#")]
    assert set(inside) <= set(document.ids)
    assert {"laws", "work_precision"} <= set(inside)  # [laws](laws.md) leads to the room, not to the file
    assert {link for link in document.links if not link.startswith("#")} == {"data:,", "costs.csv"}


def test_the_page_needs_no_network(text):
    assert set(re.findall(r"https?://[^\s\"'<)]*", text)) == {
        "http://www.w3.org/2000/svg"
    }  # a name, not an address
    for fetching in ("@import", "fetch(", "XMLHttpRequest", "WebSocket", "import("):
        assert fetching not in text
    assert "default-src 'none'" in text  # and the browser is told to refuse


def test_every_cell_finding_and_point_is_there(text):
    document = Document(text)
    for said in ("All but one keep it", "28 rows", "on particle", "two", "50 rows", "x < y"):
        assert said in document.text
    for name in NAMES:
        assert name in document.text
    assert 'class="best" data-v="0"' in text
    drawn = json.loads(document.payload)["figures"]
    assert set(drawn) == {"particle", "central"}
    flat, ball, heat = drawn["particle"]["panels"]
    assert [c["method"] for c in flat["curves"]] == list(NAMES)
    assert flat["curves"][1]["x"] == list(curves()[1].x)
    assert len(flat["curves"][1]["low"]) == 4
    assert max(max(map(abs, c["x"])) for c in ball["curves"]) < 1.3  # seen from one side, as plane curves
    assert heat["heat"]["colors"][0] == [page.COLD, "#ffffff", page.HOT]


def test_equal_rooms_give_an_equal_page(text):
    assert page.page(rooms(), RUNS) == text


def test_what_a_row_says_cannot_break_the_page():
    evil = "</script><b onclick=x>"
    rows = ((word(evil), number(1.0, lambda v: evil)),)
    view = View("evil", evil, evil, (Head(evil), Head("n", evil)), rows)
    bad = Figure(
        "bad",
        evil,
        (Panel(evil, Axis(evil), Axis(""), (Curve((1.0,), (math.nan,), evil, evil, hints=(evil,)),)),),
    )
    document = Document(page.page([page.Said(room(), (view, bad, Text(evil)), ())], [{evil: evil}]))
    assert not document.wrong
    assert not [given for tag, given in document.open if "onclick" in given]
    (panel,) = json.loads(document.payload)["figures"]["bad"]["panels"]
    assert (panel["title"], panel["curves"][0]["y"]) == (evil, [None])


def test_an_empty_page_is_a_page():
    """The environment stands where there are runs to tell of."""
    for runs in ([], RUNS):
        document = Document(page.page([], runs))
        assert not document.wrong
        assert document.ids.count("environment") == bool(runs)


def test_colours_stand_out_from_the_dark_page_and_markers_are_matplotlibs():
    for method, own in METHODS.items():
        style = page.style(f"method {method}")
        assert (style.light, style.dark) == (own.color, own.dark)
    for role in ROLES:
        dark = page.luminance(page.style(f"role {role}").dark)
        assert (dark + 0.05) / (page.luminance(page.DARK_PAPER) + 0.05) >= page.CONTRAST
    assert page.outline("s") == "M-0.5 0.5L0.5 0.5L0.5 -0.5L-0.5 -0.5Z"
    assert page.outline("o").count("C") == 8
    assert page.luminance("#ffffff") == pytest.approx(1)
    assert page.luminance("#777777") == pytest.approx(0.184, abs=1e-3)  # 4.48 against white, WCAG's example


# -- in a browser ----------------------------------------------------------------------------------
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
MISSING = "no chromium and chromedriver here (Debian: chromium, chromium-driver)"
QUIET = (
    "--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--hide-scrollbars",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
WIDE, NARROW = (1280, 900), (390, 844)


@pytest.fixture(scope="module")
def chrome(text, tmp_path_factory):
    if not (CHROMIUM and DRIVER):
        if os.environ.get("CI"):  # continuous integration installs them: to skip there would go unnoticed
            pytest.fail(MISSING)
        pytest.skip(MISSING)
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


def opened(chrome, size=WIDE, scheme="light", hash=""):
    """A fresh view of the page."""
    width, height = size
    screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": width < 600}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    chrome.get("about:blank")
    chrome.get(chrome.address + hash)
    return chrome


def find(chrome, selector):
    return chrome.find_elements("css selector", selector)


def visible(chrome, selector):
    return [found for found in find(chrome, selector) if found.is_displayed()]


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["desktop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_without_an_error_and_scrolls_in_one_direction(chrome, size, scheme):
    opened(chrome, size, scheme)
    assert chrome.get_log("browser") == []
    wide, view = chrome.execute_script("return [document.documentElement.scrollWidth, innerWidth]")
    assert wide <= view == size[0]
    paper = chrome.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert paper == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(16, 20, 24)")
    assert len(visible(chrome, ".plot svg")) == 3
    # what is wider than the screen scrolls in its own box
    outside = """return [...document.querySelectorAll("main *, header *")].filter((e) => e.checkVisibility()
        && !e.closest(".box, .unseen, .plot, .symbols") && e.getBoundingClientRect().right > innerWidth + 1).length"""
    assert chrome.execute_script(outside) == 0


def test_a_scene_is_chosen_and_the_address_remembers_it(chrome):
    from selenium.webdriver.support.select import Select

    opened(chrome)
    assert [o.get_attribute("data-option") for o in visible(chrome, ".option")] == ["particle"]
    Select(find(chrome, "select")[0]).select_by_visible_text("central")
    assert [o.get_attribute("data-option") for o in visible(chrome, ".option")] == ["central"]
    assert "scene=central" in chrome.current_url
    address = chrome.current_url[len(chrome.address) :]
    opened(chrome, hash=address)
    assert [o.get_attribute("data-option") for o in visible(chrome, ".option")] == ["central"]
    assert len(visible(chrome, '.plot .line[data-name="rk4"] .dot')) == 4


def test_a_hidden_method_is_hidden_everywhere_and_the_rest_takes_its_room(chrome):
    from selenium.webdriver.common.keys import Keys

    opened(chrome)

    def lines(method):
        return len(find(chrome, f'.line[data-name="{method}"]'))

    def curve():
        return visible(chrome, '.line[data-name="rk4"] .curve')[0].get_attribute("d")

    before, keys = curve(), find(chrome, '.key[value="my-own"]')
    assert lines("my-own") == 1  # the other scene is not shown, hence not drawn
    keys[0].click()
    assert (lines("my-own"), keys[0].get_attribute("aria-pressed")) == (0, "false")
    assert [key.get_attribute("aria-pressed") for key in keys] == ["false", "false"]
    assert curve() != before  # the axes follow
    assert "hide=my-own" in chrome.current_url
    keys[0].send_keys(Keys.SPACE)
    assert (lines("my-own"), curve()) == (1, before)
    visible(chrome, '.key[value="none"]')[0].click()
    assert not find(chrome, '.line:not([data-name=""])')
    visible(chrome, '.key[value="all"]')[0].click()
    assert lines("rk4") == 1
    assert chrome.get_log("browser") == []


def test_points_tell_what_they_are_to_mouse_and_keyboard(chrome):
    from selenium.webdriver.common.action_chains import ActionChains
    from selenium.webdriver.common.keys import Keys

    opened(chrome)
    figure = visible(chrome, ".plot svg")[0]
    chrome.execute_script("arguments[0].scrollIntoView({block: 'center'})", figure)
    dot = visible(chrome, '.line[data-name="my-own"] .dot')[1]
    ActionChains(chrome).move_to_element(dot).perform()
    (tip,) = visible(chrome, ".tip")
    for said in ("my-own", "error", "1.000e-4".replace("1.000", "1.00"), "my-own at error 0.0001"):
        assert said in tip.text
    assert {line.get_attribute("data-name") for line in find(chrome, ".line.lit")} == {"my-own"}
    ActionChains(chrome).move_to_element(find(chrome, "h2")[0]).perform()
    assert not visible(chrome, ".tip")

    spoken = find(chrome, "#spoken")[0]
    said = []
    for press in (Keys.ARROW_RIGHT, Keys.ARROW_RIGHT, Keys.ARROW_DOWN):
        figure.send_keys(press)
        said.append(spoken.get_attribute("textContent"))
    assert len(set(said)) == 3
    first, second, other = (line.partition(",")[0] for line in said)
    assert first == second != other  # right: along the curve; down: to another one
    figure.send_keys(Keys.ESCAPE)
    assert not visible(chrome, ".tip")


SORTED = """
const table = arguments[0];
return [...table.querySelectorAll("tr.heads > th")].flatMap((head, column) => [1, 2].map(() => {
  head.querySelector("button").click();
  return [head.getAttribute("aria-sort"), table.querySelectorAll("[aria-sort]").length,
    [...table.tBodies[0].rows].map(({ cells }) =>
      "v" in cells[column].dataset ? Number(cells[column].dataset.v) : cells[column].textContent.trim())];
}));
"""


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


def test_a_long_table_is_filtered_by_words(chrome):
    opened(chrome)
    visible(chrome, "details.more > summary")[0].click()
    (field,) = visible(chrome, "input.filter")
    field.send_keys("rk4")
    shown = [row.text for row in visible(chrome, "#view-rows tbody tr")]
    assert len(shown) == sum(row[0].text == "rk4" for row in ROWS.rows)
    assert all("rk4" in row for row in shown)


def test_mathtext_is_words_and_levels():
    assert words.runs(r"$|e^{\int\Gamma'} J_0|$ of *this*") == [
        ("|e", 0), ("∫Γ'", 1), (" J", 0), ("0", -1), ("|", 0), (" of this", 0),
    ]  # fmt: skip
    assert words.plain("$H_0$ against $10^{-3}$") == "H_0 against 10^-3"


def test_an_axis_is_chosen_and_the_address_remembers_it(chrome):
    from selenium.webdriver.support.select import Select

    opened(chrome)
    (choice,) = visible(chrome, 'select[data-axis="error"]')
    assert [o.get_attribute("value") for o in Select(choice).options] == ["error", "drift"]

    def label():
        return visible(chrome, ".plot svg")[0].text

    def curve():
        return visible(chrome, '.line[data-name="rk4"] .curve')[0].get_attribute("d")

    before = curve()
    Select(choice).select_by_value("drift")
    assert "drift" in label()
    assert "^" not in label()  # a superscript is set as one
    assert curve() != before  # error bars and the range follow
    assert "axis.error=drift" in chrome.current_url
    opened(chrome, hash=chrome.current_url[len(chrome.address) :])
    assert "drift" in label()
    Select(visible(chrome, 'select[data-axis="error"]')[0]).select_by_value("error")
    assert (curve(), "axis." in chrome.current_url) == (before, False)


def test_the_best_are_in_colour_and_the_others_grey_until_asked_for(chrome):
    opened(chrome, hash="#work_precision;scene=central")
    assert chrome.get_log("browser") == []  # values of any size are drawn

    def color(name):
        return visible(chrome, f'.line[data-name="{name}"] .curve')[0].value_of_css_property("stroke")

    grey = color("grey")
    assert not visible(chrome, '.line[data-name="grey"] .dot')
    visible(chrome, '.key[value="colours"]')[0].click()
    assert color("grey") != grey
    assert len(visible(chrome, '.line[data-name="grey"] .dot')) == 2
    assert "colours=all" in chrome.current_url
    opened(chrome, hash=chrome.current_url[len(chrome.address) :])
    assert color("grey") != grey


def test_an_axis_ends_where_it_is_told_unless_nothing_is_left_then(chrome):
    opened(chrome, hash="#work_precision;scene=central")
    assert "beyond: far" in visible(chrome, ".plot svg")[0].text
    assert len(visible(chrome, '.line[data-name="rk4"] .curve')) == 1
    ticks = visible(chrome, ".plot svg")[0].text
    assert "10³⁹" not in ticks
    opened(chrome, hash="#work_precision;scene=central;hide=contact-strang,rk4,heyoka-taylor,my-own,grey")
    assert len(visible(chrome, '.line[data-name="far"] .dot')) >= 2


def test_filters_and_order_of_a_table_are_in_the_address(chrome):
    opened(chrome)
    visible(chrome, "details.more > summary")[0].click()
    visible(chrome, "#view-rows input.filter")[0].send_keys("rk4")
    visible(chrome, "#view-rows thead button")[1].click()
    address = chrome.current_url[len(chrome.address) :]
    assert "filter.rows=rk4" in address
    assert "sort.rows=1%2Cup" in address
    rows = [row.text for row in visible(chrome, "#view-rows tbody tr")]
    opened(chrome, hash=address)
    assert [row.text for row in visible(chrome, "#view-rows tbody tr")] == rows
    assert all("rk4" in row for row in rows)


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["desktop", "phone"])
def test_names_at_curves_stand_apart_and_words_stay_in_their_figure(chrome, size):
    opened(chrome, size)
    boxes = """return [...document.querySelectorAll(arguments[0])].filter((e) => e.checkVisibility())
        .map((e) => { const b = e.getBoundingClientRect(), f = e.ownerSVGElement.getBoundingClientRect();
            return [b.left, b.top, b.right, b.bottom, f.left, f.top, f.right, f.bottom]; })"""
    names = chrome.execute_script(boxes, ".plot .note-text")
    assert len(names) >= 2
    for i, (left, top, right, bottom, *_) in enumerate(names):
        for x0, y0, x1, y1, *_ in names[:i]:
            assert right <= x0 + 3 or x1 <= left + 3 or bottom <= y0 + 4 or y1 <= top + 4
    for left, top, right, bottom, x0, y0, x1, y1 in chrome.execute_script(boxes, ".plot text"):
        assert x0 - 1 <= left
        assert right <= x1 + 1
        assert y0 - 1 <= top
        assert bottom <= y1 + 1


def test_mathematics_in_a_sentence_is_set():
    assert words.inline("H e^{∫Γ'} and $H_0$, `e^{x}`") == (
        "H e<sup>∫Γ&#39;</sup> and H<sub>0</sub>, <code>e^{x}</code>"
    )
    assert words.plain("H e^{∫Γ'} and $H_0$") == "H e^(∫Γ') and H_0"


def test_every_section_is_reached_from_the_row_of_links_and_what_is_shown_stays_in_the_address(chrome):
    opened(chrome, hash="#;hide=rk4")
    assert all(link.rect["x"] + link.rect["width"] <= WIDE[0] for link in find(chrome, "nav a"))
    last = find(chrome, "nav a")[-1]
    section = last.get_attribute("href").rpartition("#")[2]
    last.click()
    assert chrome.current_url.endswith(f"#{section};scene=particle;hide=rk4")
    opened(chrome, NARROW, hash=f"#{section}")
    chrome.execute_async_script("setTimeout(arguments[0], 300)")
    marked = [a for a in find(chrome, "nav a") if a.get_attribute("aria-current")]
    assert all(a.rect["x"] >= 0 and a.rect["x"] + a.rect["width"] <= NARROW[0] for a in marked)
    assert marked


def test_a_scene_that_a_figure_does_not_have_leaves_it_as_it_is(chrome, tmp_path):
    from selenium.webdriver.support.select import Select

    def sections(*names):
        return tuple(Section(s, (Text(s),), choice="scene", anchor=f"{names[0]}-{s}") for s in names)

    said = [page.Said(room("one"), sections("particle", "central"), ()),
            page.Said(room("two"), sections("central", "needle", "particle"), ())]  # fmt: skip
    path = tmp_path / "report.html"
    path.write_text(page.page(said, RUNS), encoding="utf-8")
    chrome.get(path.as_uri())

    def chosen():
        return [o.get_attribute("data-option") for o in visible(chrome, ".option")]

    first, second = find(chrome, "select")
    Select(second).select_by_visible_text("central")
    assert chosen() == ["central", "central"]
    Select(second).select_by_visible_text("needle")
    assert chosen() == ["central", "needle"]
    Select(first).select_by_visible_text("particle")
    assert chosen() == ["particle", "particle"]

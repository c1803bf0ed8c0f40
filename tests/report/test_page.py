"""The HTML page: what it holds is what the chapters hold; and it works in a real browser, wide and narrow."""

import json
import math
import os
import re
import shutil
from html.parser import HTMLParser

import pytest
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

import contactbench as cb
from contactbench.report import page, race
from contactbench.report.chapters import Answer, Chapter, Contents, Section, Text
from contactbench.report.drawing import Figure
from contactbench.report.views import Cell, Mark, View, frame_of

VOID = {"meta", "link", "br", "wbr", "img", "input", "hr"}
NAMES = ("contact-strang", "rk4", "my-own")


# -- chapters made up for the purpose ----------------------------------------------------------------
CELLS = [(name, Cell("≤ 2e-6", 2e-6 * k, None if k else Mark.best), None) for k, name in enumerate(NAMES)]
HEADS = [("", "method"), ("error", "1e-03"), ("error", "1e-06")]
COSTS = View("costs", "Costs", frame_of(CELLS, HEADS), "The **cheapest**; see [laws](laws.md).", "costs.csv")
NUMBERS = [(NAMES[k % 3], math.inf if k == 9 else (k * 7) % 50) for k in range(50)]
ROWS = View("rows", "All rows", frame_of(NUMBERS, ["method", "n"]))


def contents(parts, name="work_precision", questions=(("Is it *fast*?", "yes", "3 of 4"),)):
    chapter = Chapter(name, name, "", 1, (name,), lambda frames: ())
    return Contents(chapter, tuple(Answer(*each) for each in questions), parts)


@pytest.fixture(scope="module")
def text():
    section, drawn = Section("particle", (Text("on particle"),)), Figure("drawn", "a figure", ())
    first = contents((Text("Dimensionless.", ("one",)), COSTS, ROWS, section, drawn))
    second = contents((Text("see [cost](work_precision.md)"),), "laws")
    return page.page([first, second], [{"commit": "x < y", "run": "first"}], images={"drawn": "data:,"})


class Document(HTMLParser):
    """What is opened and closed, ids, links, and the data of the script."""

    def __init__(self, text):
        super().__init__()
        self.open, self.wrong, self.ids, self.links, self.payload, self.text = [], [], [], [], "", ""
        self.feed(text)
        self.data = json.loads(self.payload)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.ids += [given["id"]] if "id" in given else []
        self.links += [given[name] for name in ("href", "src") if name in given]
        if tag not in VOID:
            self.open.append((tag, given))

    def handle_endtag(self, tag):
        if tag not in VOID and (not self.open or self.open.pop()[0] != tag):
            self.wrong.append(tag)

    def handle_data(self, data):
        if self.open and self.open[-1][1].get("id") == "data":
            self.payload += data
        self.text += data


def test_the_page_is_well_formed_and_needs_no_network(text):
    document = Document(text)
    assert not document.wrong
    assert not document.open
    assert len(set(document.ids)) == len(document.ids)
    assert {link[1:] for link in document.links if link.startswith("#")} <= set(document.ids)
    assert {link for link in document.links if not link.startswith("#")} == {"data:,"}
    assert not re.findall(r"https?://(?!www.w3.org/2000/svg)", text)
    assert "default-src 'none'" in text  # and the browser is told to refuse


def test_every_entry_is_there(text):
    data = Document(text).data
    assert data["costs"]["rows"][:2] == [
        ["contact-strang", ["≤ 2e-6", 0.0, "best"], "—"],
        ["rk4", ["≤ 2e-6", 2e-6], "—"],
    ]
    assert data["costs"]["legend"] == 'The <strong>cheapest</strong>; see <a href="#laws">laws</a>.'
    assert len(data["rows"]["rows"]) == 50


def test_what_a_row_holds_cannot_break_the_page():
    evil = "</script><b onclick=x>"
    view = View("evil", evil, frame_of([(evil,)], [evil]), evil)
    document = Document(
        page.page([contents((view, Text(evil)), evil, ((evil,) * 3,))], [{evil: evil, "run": evil}])
    )
    assert not document.wrong
    assert not [given for _, given in document.open if "onclick" in given]
    assert evil not in json.dumps([document.data["evil"][name] for name in ("legend", "heads", "rows")])
    assert Document(page.page([])).data == {}


@pytest.mark.parametrize(
    ("text", "html"),
    [
        ("H e^{∫Γ'} and $H_0$, `e^{x}`", "H e<sup>∫Γ&#39;</sup> and H<sub>0</sub>, <code>e^{x}</code>"),
        (r"$|e^{\int\Gamma'} J_0|$ of *this*", "|e<sup>∫Γ&#39;</sup> J<sub>0</sub>| of <em>this</em>"),
        ("[x](javascript:y)", "[x](javascript:y)"),
    ],
)
def test_inline_marks_and_mathematics_are_set(text, html):
    assert page.inline(text) == html


# -- in a browser ----------------------------------------------------------------------------------
CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
DRIVER = shutil.which("chromedriver")
WIDE, NARROW = (1280, 900), (390, 844)


@pytest.fixture(scope="module")
def chrome(text, tmp_path_factory):
    if not (CHROMIUM and DRIVER):
        missing = "no chromium and chromedriver here (Debian: chromium, chromium-driver)"
        if os.environ.get("CI"):  # continuous integration installs them: to skip there would go unnoticed
            pytest.fail(missing)
        pytest.skip(missing)
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(text, encoding="utf-8")
    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for argument in ("headless=new", "no-sandbox", "disable-gpu", "hide-scrollbars"):
        options.add_argument(f"--{argument}")
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.address = path.as_uri()
    yield driver
    driver.quit()


def opened(chrome, size=WIDE, scheme="light"):
    screen = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": size[0] < 600}
    chrome.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", screen)
    features = [{"name": "prefers-color-scheme", "value": scheme}]
    chrome.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})
    chrome.get("about:blank")
    chrome.get(chrome.address)
    return chrome


def visible(chrome, selector):
    return [found for found in chrome.find_elements("css selector", selector) if found.is_displayed()]


@pytest.mark.parametrize("size", [WIDE, NARROW], ids=["desktop", "phone"])
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_it_opens_without_an_error_and_scrolls_in_one_direction(chrome, size, scheme):
    opened(chrome, size, scheme)
    assert chrome.get_log("browser") == []
    assert chrome.execute_script("return document.documentElement.scrollWidth") <= size[0]
    paper = chrome.execute_script("return getComputedStyle(document.body).backgroundColor")
    assert paper == ("rgb(255, 255, 255)" if scheme == "light" else "rgb(16, 20, 24)")


def test_a_table_is_drawn_when_it_is_opened_and_sorted_with_blanks_last(chrome):
    opened(chrome)
    assert len(visible(chrome, "table")) == 2  # the answers
    next(s for s in visible(chrome, ".view > summary") if s.text.startswith("All rows")).click()
    chrome.execute_async_script("setTimeout(arguments[0], 100)")  # the event follows the click
    (head,) = (h for h in visible(chrome, ".heads th") if h.text == "n")
    for reverse in (False, True):
        head.click()
        cells = [row.text.split()[-1] for row in visible(chrome, '[data-view="rows"] tbody tr')]
        numbers = [math.inf if cell == "∞" else float(cell) for cell in cells]
        assert numbers == sorted(numbers, reverse=reverse)
    visible(chrome, '[data-view="rows"] input')[0].send_keys("rk4")
    rows = visible(chrome, '[data-view="rows"] tbody tr')
    assert len(rows) == 17
    assert all("rk4" in row.text for row in rows)


# -- the page of a race ------------------------------------------------------------------------------
#: of every image of the page, whether it is shown, and of the curves in it those that lead through their axes
CURVES = """
return [...document.querySelectorAll("figure img")].map((image) => {
  const text = new TextDecoder().decode(Uint8Array.from(atob(image.src.split(",")[1]), (c) => c.charCodeAt(0)));
  const box = document.createElement("div");
  box.innerHTML = text.slice(text.indexOf("<svg"));
  document.body.append(box);
  const visible = [...box.querySelectorAll("path[clip-path]")].filter((path) => {
    const own = path.getBBox();
    const clip = box.querySelector(path.getAttribute("clip-path").slice(4, -1)).querySelector("rect").getBBox();
    const inside = own.x < clip.x + clip.width && own.x + own.width > clip.x
      && own.y < clip.y + clip.height && own.y + own.height > clip.y;
    return inside && own.width > 5 && own.height > 5 && getComputedStyle(path).stroke !== "none";
  });
  box.remove();
  return [image.complete && image.naturalWidth > 0, visible.length];
});
"""


@pytest.mark.quick(scene="oscillator")
@pytest.mark.parametrize("scene", ["oscillator", "equations"])
def test_the_page_of_a_race_draws_every_curve_and_the_motion(chrome, tmp_path, scene):
    rhs = cb.Equations(rhs=lambda t, y: (y[1], -y[0] - y[1] / 5), y0=(1.0, 0.0), t_end=10.0)
    raced = ["rk4", "contact-rkn6"] if scene == "oscillator" else ["rk4", "rk8"]
    frame = cb.compare(rhs if scene == "equations" else scene, raced, (1e-2, 1e-4, 1e-6), budget=60.0)
    path = tmp_path / "race.html"
    path.write_text(race.html(frame), encoding="utf-8")
    opened(chrome)
    chrome.get(path.as_uri())
    costs, motion = race.figure(frame), race.motion_figure(frame)
    assert [panel.title for panel in motion.panels[:2]] == ["Motion", "Phase portrait"]
    assert len(motion.panels) == (3 if scene == "oscillator" else 2)
    for image in visible(chrome, "figure img"):  # it is loaded when it comes into view
        chrome.execute_script("arguments[0].scrollIntoView()", image)
    wait = WebDriverWait(chrome, 20)
    wait.until(lambda chrome: all(shown for shown, _ in chrome.execute_script(CURVES)))
    found = [count for _, count in chrome.execute_script(CURVES)]
    assert found == [sum(len(panel.curves) for panel in each.panels) for each in (costs, motion)]
    assert all(
        "Take " in item.text for item in visible(chrome, "section ul")[0].find_elements("tag name", "li")
    )
    assert chrome.get_log("browser") == []

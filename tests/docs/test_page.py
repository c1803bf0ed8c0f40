"""The page of the site in a browser, wide and narrow, light and dark: ``tox -e docs`` builds it and runs this.

What it shows is compared with the tables that it was made of.
"""

import colorsys
import importlib
import json
import math
import re
import shutil
from html import unescape
from types import SimpleNamespace

import numpy as np
import pytest

import contactbench as cb
from cases import REPOSITORY

pytestmark = pytest.mark.browser
PAGE = REPOSITORY / "site" / "explore.html"
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
SIZES = {"wide": (1280, 900), "narrow": (390, 844)}
#: contrast of what is drawn with its ground (WCAG 2.2, 1.4.11), of text (1.4.3)
DRAWN, TEXT = 3.0, 4.5


@pytest.fixture(scope="module")
def source():
    """Return the module that makes the page; plotly and MkDocs come with the documentation alone."""
    return importlib.import_module("docs.page.page")


@pytest.fixture(scope="module")
def rows(source):
    """Return the runs that the page shows."""
    return source.table(REPOSITORY / "results")


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = next(filter(None, map(shutil.which, BROWSERS)), None)
        browser = playwright.chromium.launch(executable_path=found)
        yield browser
        browser.close()


@pytest.fixture(params=[(size, scheme) for size in SIZES for scheme in ("light", "dark")], ids="-".join)
def shown(browser, request):
    """Open the page; whatever it asks for or complains of fails the test."""
    size, scheme = request.param
    width, height = SIZES[size]
    context = browser.new_context(viewport={"width": width, "height": height}, color_scheme=scheme)
    context.set_default_timeout(120_000)
    page, complaints, asked = context.new_page(), [], []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: asked.append(request.url.split("#")[0]))
    page.goto(PAGE.as_uri())
    page.wait_for_selector("#plot .trace")
    if size == "narrow":
        page.click("#choose summary")
    yield page
    assert not complaints
    assert {url for url in asked if not url.startswith("data:")} == {PAGE.as_uri()}
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    context.close()


def curves(page):
    """Return name, ordinates and colour of each curve that is drawn, and what draws it."""
    found = page.evaluate(
        "document.getElementById('plot').data.map((trace) => [trace.name, trace.y, trace.line.color])"
    )
    paths = page.eval_on_selector_all("#plot .trace", "all => all.map((trace) => trace.innerHTML)")
    assert len(found) == len(paths)
    return [(*one, path) for one, path in zip(found, paths, strict=True)]


def checked(page):
    return page.eval_on_selector_all("#methods input:checked", "all => all.map((box) => box.value)")


def listed(page, column):
    """Return the texts of a column of the table."""
    heads = page.locator("thead button").all_text_contents()
    return page.locator(f"tbody td:nth-child({heads.index(column) + 1})").all_text_contents()


def luminance(color):
    numbers = re.findall(r"\d+", color) if color.startswith("rgb") else bytes.fromhex(color[1:])
    parts = [int(number) / 255 for number in numbers][:3]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one, other):
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def ground(page):
    return page.evaluate("getComputedStyle(document.body).backgroundColor")


def test_everything_stands_out_in_both_modes_and_the_button_switches(shown):
    first = ground(shown)
    for _ in range(2):
        shown.click("#all")
        drawn = [color for _, _, color, _ in curves(shown)]
        assert min(contrast(color, ground(shown)) for color in drawn) >= DRAWN
        for selector in ("h1", "main p", "td", "th button", "a", "legend"):
            ink = shown.eval_on_selector(selector, "(found) => getComputedStyle(found).color")
            assert contrast(ink, ground(shown)) >= TEXT, selector
        shown.click("#theme")
    assert ground(shown) == first
    shown.click("#theme")
    assert contrast(ground(shown), first) > 10
    shown.emulate_media(color_scheme="light")
    shown.reload()  # what the system prefers, until the button is pressed
    assert ground(shown) == "rgb(255, 255, 255)"


def test_scene_methods_and_cost_decide_the_curves(shown, rows, source):
    scenes = [*rows["scene"].unique()]
    assert shown.locator("#scene option").all_text_contents() == scenes
    assert {*shown.locator("#methods label").all_text_contents()} == {*rows["method"]}
    before = curves(shown)
    shown.select_option("#scene", scenes[1])
    assert scenes[1] in shown.locator("#title").text_content()
    after = curves(shown)
    assert [path for *_, path in after] != [path for *_, path in before]
    # what is drawn is what the tables say
    here = rows[(rows["scene"] == scenes[1]) & (rows["status"] == "ok") & rows["error"].notna()]
    compiled = here[here["engine"].map(source.ENGINES).eq("compiled") & here["least_s"].notna()]
    for name, errors, _, _ in after:
        method, _, control = name.partition(", ")
        own = compiled[(compiled["method"] == method) & compiled["control"].str.startswith(control)]
        assert sorted(errors) == sorted(max(error, source.FLOOR) for error in own["error"]), name
    # the contestants come first, and those that have no time are named
    presets = source.preset(rows[rows["scene"] == scenes[1]], source.COSTS[0])
    assert {*checked(shown)} == {*presets} == {name.partition(", ")[0] for name, *_ in after}
    gone, new = presets[0], next(name for name in compiled["method"] if name not in presets)
    shown.uncheck(f'#methods input[value="{gone}"]')
    shown.check(f'#methods input[value="{new}"]')
    drawn = {name.partition(", ")[0] for name, *_ in curves(shown)}
    assert new in drawn
    assert drawn == {*presets, new} - {gone} == {*checked(shown)}
    shown.select_option("#cost", label="evaluations")
    assert "evaluations" in shown.locator("#plot .xtitle").text_content()
    shown.click("#none")
    assert not curves(shown)
    shown.click("#all")
    without = {*rows["method"]} - {*here.loc[here["evaluations"].notna(), "method"]}
    assert {name.partition(", ")[0] for name, *_ in curves(shown)} == {*rows["method"]} - without
    assert all(name in shown.locator("#missing").text_content() for name in without)
    # the address leads back to it
    again = [name for name, *_ in curves(shown)]
    shown.reload()
    shown.wait_for_selector("#plot .trace")
    assert [name for name, *_ in curves(shown)] == again


def test_hover_shows_the_values_of_a_run(shown, rows):
    scene, method = shown.input_value("#scene"), checked(shown)[0]
    shown.click("#none")  # so that no other curve lies above
    shown.check(f'#methods input[value="{method}"]')
    name, errors, *_ = curves(shown)[0]
    place = len(errors) // 2
    assert errors[place] != errors[0]
    point = shown.locator("#plot .trace").first.locator(".point").nth(place)
    point.scroll_into_view_if_needed()
    point.hover(force=True)
    shown.wait_for_selector(".hoverlayer .hovertext")
    text = "\n".join(shown.locator(".hoverlayer tspan.line").all_text_contents())
    assert name in text
    said = float(re.search(r"error ([\d.e+-]+)", text)[1])
    assert math.isclose(said, errors[place], rel_tol=5e-3)
    own = rows[(rows["scene"] == scene) & (rows["method"] == method)]
    evaluations = float(re.search(r"evaluations ([\d.e+]+)", text)[1])
    assert evaluations in {*own.loc[np.isclose(own["error"], errors[place]), "evaluations"]}
    assert re.search(r"time [\d.]+ (s|ms|µs|ns)", text)


def test_the_table_sorts_and_filters(shown, rows, source):
    scene = shown.input_value("#scene")
    here = rows[(rows["scene"] == scene) & rows["engine"].map(source.ENGINES).eq("compiled")]
    shown.click("#all")
    assert len(listed(shown, "method")) == len(here)
    assert shown.locator("#count").text_content() == f"{len(here)} rows"
    for column in ("evaluations", "error"):
        head = shown.locator("thead button", has_text=re.compile(f"^{column}$"))
        for reverse in (False, True):
            head.click()
            while (told := head.locator("..").get_attribute("aria-sort")) == "none":
                head.click()
            texts = listed(shown, column)
            numbers = [float(text) for text in texts if text]
            assert texts[len(numbers) :] == [""] * (len(texts) - len(numbers))  # blanks are last
            assert numbers == sorted(numbers, reverse=told == "descending"), (column, reverse)
            assert len(numbers) == here[column].notna().sum()
    shown.locator("thead button", has_text=re.compile("^method$")).click()
    assert listed(shown, "method") == sorted(here["method"])
    method = here["method"].iloc[0]
    shown.fill("#filter", f"{method} error<1e-3")
    wanted = here[here["method"].str.contains(method, regex=False) & (here["error"] < 1e-3)]
    assert len(listed(shown, "method")) == len(wanted) < len(here)
    shown.fill("#filter", "no such word")
    assert not listed(shown, "method")


def test_what_a_table_holds_cannot_break_the_page(source, rows):
    evil = "</script><b onclick=x><!--"
    data = source.content(rows.assign(message=evil))
    text = source.html(data)
    assert evil not in text
    (held,) = re.findall(r'<script id="data" type="application/json">(.*?)</script>', text, re.S)
    assert json.loads(held) == data
    assert "default-src 'none'" in text  # the browser is told to fetch nothing


def test_the_page_has_every_run_to_the_end_and_its_time(source, rows):
    runs, times = cb.results("runs", REPOSITORY / "results"), cb.results("times", REPOSITORY / "results")
    held = source.content(rows)["rows"]
    assert len(held["scene"]) == (runs["saved"] == 1).sum()
    key = ["scene", "method", "engine", "control", "setting"]
    timed = runs[runs["saved"] == 1].merge(times[times["saved"] == 1], on=key)["least_s"]
    assert sorted(t for t in held["least_s"] if t is not None) == sorted(timed.dropna())


def test_a_colour_keeps_its_hue_on_a_dark_ground(source):
    def hue(color):
        return colorsys.rgb_to_hls(*(part / 255 for part in bytes.fromhex(color[1:])))[0]

    for color in source.FAMILIES.values():
        assert hue(source.dark(color)) == pytest.approx(hue(color), abs=0.01)


# -- the hooks of the site: code that runs, links between folders, formulas --------------------------
CODE = "```python\n{}\n```\n"


@pytest.fixture(scope="module")
def hooks():
    return importlib.import_module("docs.hooks")


def page(hooks, source):
    return SimpleNamespace(file=SimpleNamespace(src_uri=source, name=source[:-3]))


def test_code_of_a_page_that_is_run_shows_its_output_and_its_figures(hooks):
    text = CODE.format("x = 20") + CODE.format(
        "from matplotlib import pyplot\nprint(x + 1)\npyplot.title('a line')"
    )
    files, config = [], importlib.import_module("mkdocs.config.defaults").MkDocsConfig()
    config.site_dir, config.use_directory_urls, config.plugins = (
        "site",
        False,
        SimpleNamespace(_current_plugin=None),
    )
    shown = hooks.on_page_markdown(text, page(hooks, hooks.RUN[0]), config, files)
    assert "```text\n21\n```" in shown
    assert f"![a line](figures/{hooks.RUN[0][:-3]}-0.svg)" in shown
    assert [file.src_uri for file in files] == [f"figures/{hooks.RUN[0][:-3]}-0.svg"]
    assert hooks.on_page_markdown(text, page(hooks, "other.md"), None, []) == text


def test_links_lead_to_the_site_and_a_link_out_of_it_is_its_words(hooks):
    text = "[a](../results/cost.md), [b](../docs/gate.md), [c](../CONTRIBUTING.md#d)"
    shown = hooks.on_page_markdown(text, page(hooks, "other.md"), None, [])
    assert shown == "[a](results/cost.md), [b](../gate.md), c"


@pytest.mark.parametrize(("tag", "display"), [("span", "inline"), ("div", "block")])
def test_formulas_are_mathml(hooks, tag, display):
    left, right = ("\\(", "\\)") if tag == "span" else ("\\[", "\\]")
    html = f'<{tag} class="arithmatex">{left}q \\mathrel{{+}}= h{right}</{tag}>'
    shown = hooks.on_page_content(html, page(hooks, "other.md"), None, [])
    assert f'display="{display}"' in shown
    assert "<mo>+=</mo>" in unescape(shown)

"""The hooks of the site: code that runs, links between folders, formulas; MkDocs comes with the documentation alone."""

import importlib
from html import unescape
from types import SimpleNamespace

import pytest

pytestmark = pytest.mark.browser
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

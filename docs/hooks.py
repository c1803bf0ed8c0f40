"""What the site adds to Markdown.

Formulas as MathML, so that no script is fetched; the results as pages; and what code draws and shows.
"""

import ast
import re
from contextlib import redirect_stdout
from html import unescape
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

from latex2mathml.converter import convert
from matplotlib import pyplot
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.exceptions import PluginError
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

import contactbench as cb

ROOT = Path(__file__).parent.parent
#: pages whose code is run, block after block
RUN = ("tutorial.md", "gallery.md", "api.md")
BLOCK = re.compile(r"^```python\n(.*?)^```\n", re.S | re.M)
#: a link to a file that the site does not have
OUTSIDE = re.compile(r"\[([^\]]+)\]\((?:\.\./)+CONTRIBUTING\.md[^)]*\)")
#: q += … as one sign
ASSIGNED = re.compile(r"<mo><mrow><mo>([^<]*)</mo></mrow></mo><mo>&#x0003D;</mo>")
FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.S)


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """results/ as it is: documents, figures and tables."""
    for path in sorted((ROOT / "results").rglob("*")):
        if path.is_file():
            files.append(File.generated(config, path.relative_to(ROOT).as_posix(), abs_src_path=str(path)))
    return files


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Return the text with the links between results/ and docs/, the root of the site, and its code run.

    A link to a file that the site does not have is its words alone.
    """
    markdown = markdown.replace("](../docs/", "](../").replace("](../results/", "](results/")
    markdown = OUTSIDE.sub(r"\1", markdown)
    if page.file.src_uri not in RUN:
        return markdown
    scope: dict[str, Any] = {}

    def with_output(block: re.Match[str]) -> str:
        """Return a block, and after it what it prints, the table of its last value and its figures."""
        code, printed, shown = ast.parse(block[1]), StringIO(), [block[0]]
        last = code.body.pop().value if isinstance(code.body[-1], ast.Expr) else None
        with redirect_stdout(printed):
            exec(compile(code, page.file.src_uri, "exec"), scope)
            value = last and eval(compile(ast.Expression(last), page.file.src_uri, "eval"), scope)
        if printed.getvalue():
            shown.append(f"```text\n{printed.getvalue()}```\n")
        if html := getattr(value, "_repr_html_", lambda: None)():  # a table without a class is the theme's
            shown.append(re.sub(r"<table[^>]*>", "<table>", html) + "\n")
        for number in pyplot.get_fignums():
            figure, image = pyplot.figure(number), BytesIO()
            name = f"figures/{page.file.name}-{len(files)}.svg"
            figure.savefig(image, format="svg")
            files.append(File.generated(config, name, content=image.getvalue()))
            shown.append(f"![{figure.get_suptitle() or figure.axes[0].get_title()}]({name})\n")
        pyplot.close("all")
        return "\n".join(shown)

    return BLOCK.sub(with_output, markdown)


def on_page_content(html: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Formulas as MathML, which browsers draw by themselves; raises where the API lacks a public name."""
    if page.file.src_uri == "api.md":
        documented = {item.title for section in page.toc.items[0].children for item in section.children}
        if missing := {*cb.__all__} - documented:
            raise PluginError(f"api.md lacks {', '.join(sorted(missing))}")

    def draw(found: re.Match[str]) -> str:
        formula = convert(unescape(found[2]), display="inline" if found[1] == "span" else "block")
        formula = ASSIGNED.sub(r"<mo>\1=</mo>", formula)
        return formula if found[1] == "span" else f'<div class="formula">{formula}</div>'

    return FORMULA.sub(draw, html)

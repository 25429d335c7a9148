"""Settings of the documentation; `sphinx-build -W docs build/docs` makes it, without network."""

from __future__ import annotations

import subprocess
import sys
import tomllib
from pathlib import Path

from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList
from docutils.utils.math.latex2mathml import tex2mathml

PROJECT = tomllib.loads((Path(__file__).parent.parent / "pyproject.toml").read_text(encoding="utf-8"))["project"]

project = PROJECT["name"]
author = "the authors of fdcal"
copyright = f"{author}, MIT licence"
version = release = PROJECT["version"]

extensions = [
    "myst_parser",
    "numpydoc",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_click",
]
exclude_patterns = ["build", "_templates"]
templates_path = ["_templates"]
default_role = "code"  # docstrings and help texts write code in single backticks
pygments_style = "friendly"

myst_enable_extensions = ["attrs_block", "colon_fence", "deflist", "dollarmath"]
myst_heading_anchors = 3

autosummary_generate = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"  # numpydoc's sections name the types
autoclass_content = "class"
numpydoc_show_class_members = False  # the template of a class lists them
numpydoc_class_members_toctree = False
# What each docstring of the public API must have: sections in their order, every parameter of the signature, a type
# for each, and a summary; `sphinx-build -W` treats a violation as an error.
numpydoc_validation_checks = {
    "GL02", "GL03", "GL05", "GL06", "GL07", "GL08", "GL09", "GL10", "SS01", "SS02", "SS03", "SS04",
    "PR01", "PR02", "PR03", "PR04", "PR05", "PR10", "RT01", "YD01",
}  # fmt: skip

numpydoc_validation_overrides = {"PR01": [r"Attributes\s+-{10}"]}  # a dataclass describes its parameters there

html_math_renderer = "mathml"  # browsers draw it themselves: MathJax would have to be loaded from the network

html_theme = "pydata_sphinx_theme"
html_title = f"fdcal {version}"
html_static_path = ["_static"]
html_css_files = ["fdcal.css"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "logo": {"text": "fdcal"},
    "navbar_center": [],
    "navbar_end": ["theme-switcher"],
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": [],
    "show_prev_next": True,
    "pygments_light_style": "friendly",
    "pygments_dark_style": "github-dark",
}
html_sidebars = {"**": ["pages.html"]}


def inline_math(translator, node) -> None:
    """Write a formula within a line as MathML."""
    translator.body.append(tex2mathml(node.astext()))
    raise nodes.SkipNode


def displayed_math(translator, node) -> None:
    """Write a formula on a line of its own as MathML."""
    translator.body.append(f'<div class="formula">{tex2mathml(node.astext(), as_block=True)}</div>')
    raise nodes.SkipNode


class Replay(Directive):
    """Embed a replay of `docs/replays.py` in the page; the argument is its name and, after #, what it shows."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        name, _, shown = self.arguments[0].partition("#")
        document = self.state.document.settings.env.docname
        address, shown = f"{'../' * document.count('/')}replays/{name}.html", shown.replace("&", "&amp;")
        frame = f'<iframe src="{address}#embed=on&amp;{shown}" loading="lazy" title="{name}"></iframe>'
        whole = f'<a href="{address}#{shown}">Open it in a window of its own</a>'
        return [nodes.raw("", f'<div class="replay">{frame}{whole}</div>', format="html")]


class Findings(Directive):
    """The table of `fdcal.assessment.findings`: its checks in their order, with their limits and the reasons."""

    def run(self) -> list[nodes.Node]:
        from fdcal.assessment.findings import FINDINGS

        table = ["| verdict | limit | what is compared with the limit, and why it has this value |", "|---|---|---|"]
        for one in FINDINGS:
            table.append(f"| `{one.code}` | {f'{one.limit:g}' if one.limit else ''} | {one.reason} |")
        parent = nodes.container()
        self.state.nested_parse(StringList(table, source="findings"), self.content_offset, parent)
        return parent.children


def replays(app, error) -> None:
    """Write the replays beside the pages that show them and, with `-t site`, the gallery for a web server."""
    if error is None and app.builder.format == "html":
        sys.path.insert(0, str(Path(__file__).parent))
        from replays import write

        write(Path(app.outdir) / "replays")
        if "site" in app.tags:
            gallery = ["gallery", "-o", str(Path(app.outdir) / "gallery"), "--force"]
            subprocess.run([sys.executable, "-m", "fdcal", *gallery], check=True)


def setup(app) -> None:
    """Register the renderer of formulas and the directives `replay` and `findings`."""
    app.add_directive("replay", Replay)
    app.add_directive("findings", Findings)
    app.connect("build-finished", replays)
    app.add_html_math_renderer("mathml", (inline_math, None), (displayed_math, None))

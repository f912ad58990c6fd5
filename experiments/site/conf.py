"""The manual, by Sphinx: ``sphinx-build -W -c experiments/site . out/manual`` from the folder of the project.

It takes the pages and notebooks where they are and writes nothing beside them. Notebooks are run, and one that fails
fails the manual; what they printed is kept beside the manual for the next time. Nothing is fetched from the network.
"""

import re
from pathlib import Path

import latex2mathml.converter
from docutils import nodes
from docutils.parsers.rst import Directive
from docutils.statemachine import StringList

import gearjax

project, version, release = "gearjax", gearjax.__version__, gearjax.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
root_doc = "experiments/site/index"
include_patterns = [
    "experiments/site/*.md",
    "experiments/site/reference/*.md",
    "experiments/notebooks/*.py",
    "README.md",
    "CONTRIBUTING.md",
    "CHANGELOG.md",
]
suppress_warnings = ["toc.not_included"]  # the readme stands beside the pages, which link to it

html_theme = "furo"
html_title = f"gearjax {version}"
html_copy_source = False
html_math_renderer = "mathml"

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 3
nb_custom_formats = {".py": ["jupytext.reads", {"fmt": "py:percent"}]}
nb_execution_mode = "cache"
nb_execution_raise_on_error = True
nb_execution_timeout = 600
nb_execution_in_temp = True  # what notebooks write goes with it
nb_merge_streams = True
nb_ipywidgets_js: dict = {}

autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_numpy_docstring = False
napoleon_use_rtype = False


class Names(Directive):
    """``{names}`` lists public names; each becomes its signature and docstring."""

    has_content = True

    def run(self) -> list[nodes.Node]:
        lines = []
        for name in " ".join(self.content).split():
            thing = getattr(gearjax, name)
            if isinstance(thing, type):
                lines += [f".. autoclass:: gearjax.{name}", "   :members:", ""]
            elif callable(thing):
                lines += [f".. autofunction:: gearjax.{name}", ""]
            else:
                lines += [f".. automodule:: {thing.__name__}", ""]
        held = nodes.container()
        block = StringList(["```{eval-rst}", *lines, "```"], self.state.document.current_source)
        self.state.nested_parse(block, self.content_offset, held)
        return held.children


def plain(app, what, name, thing, options, lines: list[str]) -> None:
    """Bars and stars in docstrings are what they are, not marks of reStructuredText; single ticks are code."""
    for number, line in enumerate(lines):
        parts = re.split(r"(``[^`]*``|`[^`]*`)", line)
        for place, part in enumerate(parts):
            if place % 2:
                parts[place] = part if part.startswith("``") else f"`{part}`"
            else:
                parts[place] = re.sub(r"([|*])", r"\\\1", part)
        lines[number] = line if ">>>" in line or "... " in line else "".join(parts)


def formula(visitor, node: nodes.math | nodes.math_block) -> None:
    """TeX as MathML, which browsers show by themselves."""
    display = "block" if isinstance(node, nodes.math_block) else "inline"
    visitor.body.append(latex2mathml.converter.convert(node.astext(), display=display))
    raise nodes.SkipNode


def entrance(app, fault: Exception | None) -> None:
    """The folder opens at the first page."""
    if fault is None and app.builder.format == "html":
        target = f"{root_doc}.html"
        page = f'<!doctype html><meta charset="utf-8"><meta http-equiv="refresh" content="0; url={target}">'
        (Path(app.outdir) / "index.html").write_text(f'{page}<a href="{target}">gearjax</a>\n', encoding="utf-8")


def setup(app) -> None:
    app.add_directive("names", Names)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))
    app.connect("autodoc-process-docstring", plain, priority=100)
    app.connect("build-finished", entrance)

"""The site, built from the documents as they lie in the repository (make docs): Sphinx is run at the root of the repository."""

import sys
from pathlib import Path

from docutils.nodes import SkipNode
from docutils.utils.math import latex2mathml

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT / "src"), str(ROOT / "docs")]

import notebooks  # noqa: E402
import reference  # noqa: E402

project = author = "Motes"
root_doc = "README"
include_patterns = ["*.md", "docs/**", "examples/README.md", "examples/*/README.md", "papers/*/README.md", "benchmarks/*.md"]
exclude_patterns = ["docs/site"]
templates_path = [str(ROOT / "docs" / "site")]
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "sphinx.ext.napoleon"]

myst_enable_extensions = ["dollarmath"]
myst_heading_anchors = 4
nb_execution_mode = "cache"
nb_execution_cache_path = str(ROOT / "out" / "notebooks")
nb_execution_raise_on_error = True
nb_execution_timeout = 300
nb_merge_streams = True
nb_output_stderr = "remove"  # progress, and warnings with the path of a temporary file; the text tells of those

default_role = "code"
highlight_language = "text"
autodoc_member_order = "bysource"
autodoc_typehints = "none"
napoleon_use_ivar = True  # attributes as a list: members would be told of twice

html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "Motes"
html_static_path = ["site/static"]
html_css_files = ["motes.css"]
html_additional_pages = {"index": "start.html"}
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {"footer_start": [], "footer_end": [], "navbar_align": "left", "show_nav_level": 2}


def with_contents(app, name, source):
    """Put the table of contents under the first page, leave out of its parts what is not there, lead from examples to notebooks."""
    if name == root_doc:
        parts = "".join(f"docs/contents/{part}\n" for part in ("start", "guides", "methods", "examples", "reference"))
        source[0] += f"\n```{{toctree}}\n:hidden:\n\n{parts}```\n"
    elif name.startswith("examples/") and (ROOT / name).with_name("run.py").is_file():
        example = Path(name).parent.name
        source[0] += f"\n\n{{download}}`This example as a notebook <{example}.ipynb>`, {{download}}`its program <run.py>`.\n"
    elif name.startswith("docs/contents/"):
        lines = source[0].splitlines()
        source[0] = "\n".join(line for line in lines if "*" not in line or any((ROOT / "docs" / "contents").glob(f"{line}.md")))


def formula(self, node):
    """Show a formula as MathML, which browsers draw by themselves: the site loads nothing from elsewhere."""
    self.body.append(latex2mathml.tex2mathml(node.astext(), as_block=node.tagname == "math_block"))
    raise SkipNode


def setup(app):
    """Tell Sphinx of these."""
    reference.write(ROOT / "docs" / "api")
    notebooks.write()
    app.connect("source-read", with_contents)
    app.connect("autodoc-process-docstring", reference.escaped, priority=100)
    app.add_html_math_renderer("mathml", (formula, None), (formula, None))

"""Settings of the documentation site: `make docs` builds it, without network, and every warning is an error."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import command
import measured
import no_break
from pygments.lexers.special import TextLexer

import loewner

project = "loewner"
author = "The loewner developers"
copyright = author
version = release = loewner.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.autosummary", "numpydoc", "sphinx_copybutton"]
extensions += ["sphinx_design"]
root_doc = "index"
exclude_patterns = ["_build"]
templates_path = ["_templates"]

# -- pages in Markdown --------------------------------------------------------------------------

myst_enable_extensions = ["attrs_inline", "colon_fence", "deflist"]
myst_heading_anchors = 3
suppress_warnings = ["myst.header"]  # ARCHITECTURE.md and its like are whole pages on their own and included here

# -- reference ----------------------------------------------------------------------------------

nitpicky = True
# Arguments that are called like a module: links to them lead nowhere.
nitpick_ignore = [("py:obj", "bodies"), ("py:obj", "dataset"), ("py:obj", "start_time"), ("py:obj", "loewner.verify")]
default_role = "autolink"
autosummary_generate = True
# Shapes and units are in the docstrings; annotations can say neither.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
numpydoc_show_class_members = False
numpydoc_xref_param_type = False

# -- looks --------------------------------------------------------------------------------------

html_theme = "furo"
html_title = f"loewner {release}"
html_show_copyright = False
html_copy_source = False
html_static_path = ["_static"]
html_logo = html_favicon = "_static/logo.svg"
html_css_files = ["site.css"]
html_js_files = ["site.js"]
# Prompts, and what a program prints, are not copied.
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True
html_theme_options = {"source_repository": "", "navigation_with_keys": True}
pygments_style = "a11y-high-contrast-light"
pygments_dark_style = "github-dark"


def setup(app):
    """Write the pages that are made by programs before Sphinx looks for pages; find public names from any module."""
    app.add_lexer("mermaid", TextLexer)
    app.add_post_transform(no_break.NoBreak)
    app.connect("builder-inited", _write_pages)
    app.connect("missing-reference", _public_name)
    app.connect("build-finished", _write_for_models)


def _write_pages(app):
    measured.write(Path(app.srcdir) / "measured.md")
    command.write(Path(app.srcdir) / "reference" / "command.md")


def _write_for_models(app, error):
    """Put each page's Markdown beside its HTML, and a list of the pages, llms.txt, as language models look for it."""
    if error is not None or app.builder.format != "html":
        return
    lines = [f"# {project}", "", "> Certified collision detection for robots, meshes and convex bodies.", ""]
    for name in sorted(app.env.found_docs):
        source = Path(app.env.doc2path(name))
        if source.suffix != ".md" or name in ("architecture", "changelog"):  # which include files
            continue
        twin = Path(app.outdir, name).with_suffix(".md")
        twin.parent.mkdir(parents=True, exist_ok=True)
        twin.write_text(source.read_text(encoding="utf-8"), encoding="utf-8")
        lines.append(f"- [{app.env.titles[name].astext()}]({name}.md)")
    Path(app.outdir, "llms.txt").write_text("\n".join(lines) + "\n", encoding="utf-8")


def _public_name(app, env, node, content):
    """Where a docstring of a module such as loewner.planners names `Robot`, it means loewner.Robot."""
    python, target = env.get_domain("py"), "loewner." + node["reftarget"]
    if node.get("refdomain") != "py" or target not in python.objects:
        return None
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", target, node, content)

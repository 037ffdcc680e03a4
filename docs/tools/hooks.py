"""Hooks of MkDocs: they add the studies and examples outside of docs/ to the site, and turn formulas into MathML.

Pages link to `../experiments/NAME` and `../examples/FILE`. That works in the repository. In the site these files lie
beside the pages, so links lose their `../`, and a link to a folder becomes one to its README.
"""

import html
import posixpath
import re
from pathlib import Path

import latex2mathml.converter
from mkdocs.structure.files import File

ROOT = Path(__file__).resolve().parents[2]
OUTSIDE = (
    *("experiments/*/README.md", "experiments/*/results/*.png", "experiments/data/**/*.md"),
    *("examples/*.py", "configs/*.toml"),
)
PAGES = ("CHANGELOG.md", "CONTRIBUTING.md")
LINK = re.compile(r"(\]\()([^)#\s:]+)(#[^)\s]*)?(\))")  # relative links only: others have the colon of https:
FORMULA = re.compile(r'<(span|div) class="arithmatex">(.*?)</\1>', re.DOTALL)


def on_files(files, config):
    """Adds the files outside of docs/ that pages link to."""
    for path in sorted([found for pattern in OUTSIDE for found in ROOT.glob(pattern)] + [ROOT / p for p in PAGES]):
        name = path.relative_to(ROOT).as_posix()
        files.append(File(name, str(ROOT), config.site_dir, config.use_directory_urls))
    return files


def on_page_markdown(markdown, page, config, files):
    """Makes links that leave docs/ links within the site."""
    return LINK.sub(lambda match: _within(match, page.file.src_uri), markdown)


def _within(match: re.Match, source: str) -> str:
    start, target, anchor, end = match.groups()
    outside = (ROOT / source).exists()
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source if outside else f"docs/{source}"), target))
    if (ROOT / path).is_dir():
        path = f"{path}/README.md"
    link = posixpath.relpath(path.removeprefix("docs/"), posixpath.dirname(source) or ".")
    return f"{start}{link}{anchor or ''}{end}"


def on_page_content(content, page, config, files):
    """Turns LaTeX into MathML, which browsers draw themselves: the site loads nothing from elsewhere."""
    return FORMULA.sub(_mathml, content)


def _mathml(match: re.Match) -> str:
    kind, text = match.groups()
    latex = html.unescape(re.sub(r"^\\[(\[]|\\[)\]]$", "", text.strip())).strip()
    display = "block" if kind == "div" else "inline"
    return f'<{kind} class="formula">{latex2mathml.converter.convert(latex, display=display)}</{kind}>'

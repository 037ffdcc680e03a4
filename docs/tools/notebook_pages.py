"""Hooks of MkDocs: each notebook of docs/notebooks becomes a page of the site, with the outputs that are stored in it.

Nothing is executed and nothing is loaded from elsewhere. In the site a link to a notebook leads to its page.
"""

import base64
import json
import re
from pathlib import Path

from mkdocs.structure.files import File

FOLDER = Path(__file__).resolve().parents[1] / "notebooks"
SUFFIXES = {"image/png": "png", "image/gif": "gif"}
LINK = re.compile(r"(\]\((?!\w+:)[^)#\s]*)\.ipynb((?:#[^)\s]*)?\))")


def on_files(files, config):
    """Adds a page and its pictures for each notebook."""
    for path in sorted(FOLDER.glob("*.ipynb")):
        text, pictures = page_of(json.loads(path.read_text()), path.stem)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=text))
        for name, data in pictures.items():
            files.append(File.generated(config, f"notebooks/{path.stem}/{name}", content=data))
    return files


def on_page_markdown(markdown, page, config, files):
    """Makes links to notebooks links to their pages."""
    return LINK.sub(r"\1.md\2", markdown)


def page_of(notebook: dict, name: str) -> tuple[str, dict[str, bytes]]:
    """(the page in Markdown, its pictures by file name) of a notebook."""
    parts, pictures = [], {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            parts.append(source)
            if len(parts) == 1:  # below the heading; a page's own folder is one deeper than the notebook
                parts.append(f'<p><a href="../{name}.ipynb" download>Download this notebook</a></p>')
            continue
        parts.append(f"``` python\n{source}\n```")
        parts += [_output(output, name, pictures) for output in cell["outputs"]]
    return "\n\n".join(parts) + "\n", pictures


def _output(output: dict, name: str, pictures: dict[str, bytes]) -> str:
    """An output of a cell in Markdown. Its picture is added to `pictures`."""
    data = output.get("data", {})
    for kind, suffix in SUFFIXES.items():
        if kind in data:
            file = f"{len(pictures) + 1}.{suffix}"
            pictures[file] = base64.b64decode("".join(data[kind]))
            width = output.get("metadata", {}).get(kind, {}).get("width")
            size = f'{{ width="{width}" }}' if width else ""
            return f"![Output of the cell above]({name}/{file}){size}"
    if "text/html" in data:
        return "".join(data["text/html"])
    return f"``` text\n{''.join(output.get('text', data.get('text/plain', ''))).rstrip()}\n```"

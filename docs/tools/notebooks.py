"""Executes the notebooks of docs/notebooks and stores their outputs: `python docs/tools/notebooks.py [NAME ...]`.

Run it from the root of the checkout, in an environment with the extra `notebooks`. What differs from run to run without
saying anything is not stored: bars, notes of other packages, seconds, paths of the machine. So diffs are small.
"""

import os
import re
import sys
from pathlib import Path

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs/notebooks"
NAMES = ("first_gradient", "shape_from_views", "photographs_to_asset", "speed_against_accuracy")
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
# Lines that say nothing of the result: where programs are kept, how far a run is, what goes on.
NOISE = re.compile(r"jaxdr: compiled programs|\w[\w ]* \d+/\d+\b|[\w ]*:? +\d+%\||.*\(\d+:\d\d\)$|\s*$")
SIZED = ("image/gif",)
MOST_SECONDS = 1200  # of a cell, on a busy machine


def executed(notebook: nbformat.NotebookNode, folder: Path) -> nbformat.NotebookNode:
    """The notebook with the outputs of a run in `folder`. Raises CellExecutionError where a cell fails."""
    programs = str(Path(sys.executable).parent)  # a cell may call `jaxdr`
    path = os.pathsep.join([programs, os.environ.get("PATH", "")])
    client = NotebookClient(notebook, timeout=MOST_SECONDS, kernel_name="python3")
    return client.execute(cwd=str(folder), env=os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)})


def cleaned(notebook: nbformat.NotebookNode) -> nbformat.NotebookNode:
    """The notebook without what a run adds and no reader needs."""
    notebook.metadata = nbformat.from_dict(METADATA)
    for cell in notebook.cells:
        cell.metadata = nbformat.NotebookNode()
        if cell.cell_type == "code":
            cell.outputs = _joined([output for output in map(_cleaned, cell.outputs) if output is not None])
    return notebook


def _joined(outputs: list[nbformat.NotebookNode]) -> list[nbformat.NotebookNode]:
    """Outputs with lines that follow each other in one."""
    found: list[nbformat.NotebookNode] = []
    for output in outputs:
        if found and output.output_type == found[-1].output_type == "stream":
            found[-1].text += output.text
        else:
            found.append(output)
    return found


def _cleaned(output: nbformat.NotebookNode) -> nbformat.NotebookNode | None:
    """An output as it is stored, or None."""
    if output.output_type == "stream":
        lines = re.split(r"[\r\n]+", output.text)
        text = "".join(f"{line}\n" for line in lines if not NOISE.match(line))
        return nbformat.from_dict({**output, "text": text}) if text and output.name == "stdout" else None
    if "data" in output:
        if any("widget" in kind for kind in output.data):
            return None
        shown = {kind: size for kind, size in output.metadata.items() if kind in SIZED}  # how large a GIF is drawn
        output.metadata = nbformat.from_dict(shown)
        pictures = [kind for kind in output.data if kind.startswith("image/")]
        if pictures or "text/html" in output.data:  # the words of a picture are `<Figure …>`, those of a scene are long
            output.data.pop("text/plain", None)
    return output


def main(names: list[str]) -> None:
    """Executes notebooks one after another, in their folder, and writes them back."""
    for name in names or NAMES:
        path = FOLDER / f"{name}.ipynb"
        notebook = cleaned(executed(nbformat.read(path, as_version=4), FOLDER))
        nbformat.validate(notebook)
        nbformat.write(notebook, path)


if __name__ == "__main__":
    main(sys.argv[1:])

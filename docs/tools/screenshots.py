"""Draws docs/figures/site.png and view.png: `python -m docs.tools.screenshots RUN`, from the root of the checkout.

RUN is the folder of a run of `jaxdr optimize`. It also draws three pages of the site as a desk and a telephone show
them, for experiments/first_hour. Without RUN it draws the site alone. It needs Chromium, and the extras docs and test.
"""

import argparse
import functools
import http.server
import itertools
import subprocess
import sys
import tempfile
import threading
from pathlib import Path

import numpy as np
from PIL import Image

from tests.view.browser import show

ROOT = Path(__file__).resolve().parents[2]
FIGURES = ROOT / "docs/figures"
SIZE = (1320, 760)
PAGES = {"front": "", "reference": "api/scenes/", "mathematics": "line_sampling/"}
SCREENS = ((1280, 800), (390, 800))  # pixels
RESULTS = ROOT / "experiments/first_hour/results"


class Quiet(http.server.SimpleHTTPRequestHandler):
    """Files of a folder, without a line for each."""

    def log_message(self, *_):
        pass


def draw(page: Path | str, ready: str, path: Path, folder: Path, size: tuple[int, int] = SIZE) -> None:
    """Writes a picture of a page in the browser. Raises RuntimeError if the page has errors or loads anything else."""
    shown = show(page, ready, folder / f"profile_{path.stem}", size)
    own = ("file:", "data:", "blob:", "http://localhost:")
    outside = [address for address in shown.addresses if not address.startswith(own)]
    if shown.errors or outside:
        raise RuntimeError(f"{page}: {shown.errors} {outside}")
    # A palette is enough for flat colours, and a third of the size.
    picture = Image.fromarray(shown.pixels.astype(np.uint8)).quantize(128)
    picture.save(path, optimize=True)


def main(run: str | None) -> None:
    """Builds the site and the page of the run, and draws the top of each."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        site, page = folder / "site", folder / "view.html"
        build = ["mkdocs", "build", "--quiet", "--site-dir", str(site)]
        subprocess.run([sys.executable, "-m", *build], cwd=ROOT, check=True)
        serve = functools.partial(Quiet, directory=str(site))  # the search of a site needs a server
        with http.server.ThreadingHTTPServer(("localhost", 0), serve) as server:
            threading.Thread(target=server.serve_forever, daemon=True).start()
            address = f"http://localhost:{server.server_port}/"
            loaded = 'document.readyState === "complete"'
            draw(address, loaded, FIGURES / "site.png", folder)
            for (name, place), size in itertools.product(PAGES.items(), SCREENS):
                draw(f"{address}{place}", loaded, RESULTS / f"{name}_{size[0]}.png", folder, size)
            server.shutdown()
        if run is None:
            return
        subprocess.run([sys.executable, "-m", "jaxdr.cli", "view", run, "-o", str(page)], cwd=ROOT, check=True)
        drawn = "[...document.querySelectorAll('model-viewer')].every(viewer => viewer.modelIsVisible)"
        draw(page, f"{loaded} && {drawn}", FIGURES / "view.png", folder)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("run", nargs="?")
    main(parser.parse_args().run)

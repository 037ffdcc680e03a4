"""Pages that hold all they show: what a browser may load for one.

A page is sent to others and shows words and pictures from files. With a policy nothing in it calls for anything else.
"""

CLOSED = "default-src 'none'; base-uri 'none'; form-action 'none'; style-src 'unsafe-inline'"
STATIC = f"{CLOSED}; img-src data:"
VIEWER = (
    f"{CLOSED}; script-src 'unsafe-inline' 'wasm-unsafe-eval' blob:; img-src data: blob:; "
    "connect-src data: blob:; worker-src blob:"
)


def content_policy(viewer: bool = False) -> str:
    """The tag for the head of a page. Only a page with the viewer of meshes may run scripts, which it holds itself."""
    return f'<meta http-equiv="Content-Security-Policy" content="{VIEWER if viewer else STATIC}">'

"""Shapes and dtypes of every public signature are checked by beartype, in the tests only."""

from jaxtyping import install_import_hook

# Before the first import of the package: the hook rewrites modules as they are loaded.
install_import_hook("jaxdr", "beartype.beartype")

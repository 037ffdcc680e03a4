"""`python -m jaxdr` is the command `jaxdr`."""

import sys

from jaxdr.cli import main

if __name__ == "__main__":
    sys.exit(main())

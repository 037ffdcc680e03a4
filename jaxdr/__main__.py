"""The command `jaxdr`, also as `python -m jaxdr`."""

import signal
import sys
from typing import NoReturn

from jaxdr.cli import main


def run() -> NoReturn:
    """Run the command of this process, and end the process with its exit status."""
    status = main()
    # All is written. From here on Ctrl-C ends the process at once, and not with a traceback of its clean-up.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(status)


if __name__ == "__main__":
    run()

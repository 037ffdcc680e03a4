"""The command `jaxdr`, also as `python -m jaxdr`."""

import signal
import sys
from typing import NoReturn

INTERRUPTED = 130  # the exit status that `jaxdr.cli` has for Ctrl-C


def run() -> NoReturn:
    """Run the command of this process, and end the process with its exit status."""
    try:
        from jaxdr.cli import main  # takes a second, in which Ctrl-C prints no traceback either
    except KeyboardInterrupt:
        print("jaxdr: interrupted", file=sys.stderr)
        sys.exit(INTERRUPTED)
    status = main()
    # All is written. From here on Ctrl-C ends the process at once, and not with a traceback of its clean-up.
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(status)


if __name__ == "__main__":
    run()

"""The program ``halfshaft``: the command line, interruptible from its first import on."""

import _thread
import signal
import sys
import threading
from types import FrameType

#: How soon an interrupt is tried again that could not be raised where it came [s].
AGAIN = 0.005


def main() -> None:
    """Run the command line."""
    try:
        # A shell lets a job in the background ignore interrupts, and it stays so.
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
            signal.signal(signal.SIGINT, _interrupt)
        from halfshaft.app.cli import app

        app()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(130)


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise an interrupt, but not before CasADi is left: what is raised where it looks at an operand in Python, it drops."""
    if _within_casadi(frame):
        again = threading.Timer(AGAIN, _thread.interrupt_main)
        again.daemon = True
        again.start()
    else:
        signal.default_int_handler(number, frame)


def _within_casadi(frame: FrameType | None) -> bool:
    while frame is not None and not (name := frame.f_globals.get("__name__", "")).startswith("halfshaft."):
        if name == "casadi.casadi":
            return True
        frame = frame.f_back
    return False


if __name__ == "__main__":
    main()

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
    except BaseException as error:
        if not _is_interrupt(error):
            raise
        print("interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(130)


def _is_interrupt(error: BaseException | None) -> bool:
    """Return whether it is an interrupt, or what Python 3.11 makes of one that comes while a class is being made."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__
    return error is not None


def _interrupt(number: int, frame: FrameType | None) -> None:
    """Raise an interrupt, but not before CasADi is left: what is raised where it looks at an operand in Python, it drops."""
    if _within_casadi(frame):
        again = threading.Timer(AGAIN, _interrupt_again)
        again.daemon = True
        again.start()
    else:
        signal.default_int_handler(number, frame)


def _interrupt_again() -> None:
    # A signal also wakes a program that waits.
    if hasattr(signal, "pthread_kill"):
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)
    else:
        _thread.interrupt_main()


def _within_casadi(frame: FrameType | None) -> bool:
    while frame is not None and not (name := frame.f_globals.get("__name__", "")).startswith("halfshaft."):
        if name == "casadi.casadi":
            return True
        frame = frame.f_back
    return False


if __name__ == "__main__":
    main()

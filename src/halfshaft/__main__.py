"""The program ``halfshaft``: the command line, interruptible from its first import on."""

from __future__ import annotations

import _thread
import signal
import sys
import threading
from types import FrameType

#: How soon an interrupt is tried again that could not be raised where it came [s], and how often.
AGAIN, TRIES = 0.005, 40


def main() -> None:
    """Run the command line."""
    interrupt = Interrupt()
    try:
        # Where a shell lets a job in the background ignore interrupts, it stays so.
        if signal.getsignal(signal.SIGINT) is signal.default_int_handler and threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGINT, interrupt)
            sys.unraisablehook = interrupt.dropped
        from halfshaft.app.cli import app

        app()
    except BaseException as error:
        # CasADi makes a RuntimeError of an interrupt, and so does Python 3.11 while a class is being made.
        if not (isinstance(error, KeyboardInterrupt) or (interrupt.raised and isinstance(error, RuntimeError))):
            raise
        print("interrupted", file=sys.stderr)  # noqa: T201
        sys.exit(130)


class Interrupt:
    """Raises an interrupt until it is heard.

    Not within CasADi, for a while: what is raised where it looks at an operand in Python, it drops.  Python drops what is raised in a
    finaliser or a callback, such as one at the end of each import, and says so.
    """

    def __init__(self) -> None:
        self.tried, self.raised = 0, False
        self.shown = sys.unraisablehook

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Raise it, now or a moment later."""
        self.tried += 1
        if self.tried <= TRIES and _within_casadi(frame):
            _interrupt_later()
        else:
            # After so long it is a call that computes, which listens.
            self.tried, self.raised = 0, True
            signal.default_int_handler(number, frame)

    def dropped(self, what: sys.UnraisableHookArgs) -> None:
        """Raise an interrupt again that was dropped; show anything else."""
        if issubclass(what.exc_type, KeyboardInterrupt):
            _interrupt_later()
        else:
            self.shown(what)


def _within_casadi(frame: FrameType | None) -> bool:
    while frame is not None and not (name := frame.f_globals.get("__name__", "")).startswith("halfshaft."):
        if name == "casadi.casadi":
            return True
        frame = frame.f_back
    return False


def _interrupt_later() -> None:
    again = threading.Timer(AGAIN, _interrupt)
    again.daemon = True
    again.start()


def _interrupt() -> None:
    main = threading.main_thread().ident
    # A signal also wakes a program that waits.
    if main is not None and hasattr(signal, "pthread_kill"):
        signal.pthread_kill(main, signal.SIGINT)
    else:
        _thread.interrupt_main()


if __name__ == "__main__":
    main()

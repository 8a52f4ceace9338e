"""The command ``uwserver``; ``python -m uwserver`` is the same."""

from __future__ import annotations

import os
import signal
import sys
import threading


def start() -> None:
    """Run the command line, which imports much; a signal must be heard before that."""
    if os.getpid() == 1:
        end_on_sigterm()
    try:
        from uwserver.cli import main

        main(prog_name="uwserver")
    except MemoryError as error:
        why = f": {error}" if str(error) else ""
        print(f"uwserver: there is too little memory{why}; raise the limit (ulimit -v) or load less", file=sys.stderr)
        sys.exit(1)


def end_on_sigterm() -> None:
    """End this process at once on SIGTERM until somebody else handles it, as it ends any other process than the first of a container.

    That one gets no signal that it does not handle itself. A thread waits for it, for Python's own handlers run between two lines of Python
    only, and the compiler of kernels works for many seconds without any.
    """
    reader, writer = os.pipe()
    os.set_blocking(writer, False)
    signal.signal(signal.SIGTERM, lambda number, frame: os._exit(128 + number))
    signal.set_wakeup_fd(writer)

    def watch() -> None:
        while os.read(reader, 1) != bytes([signal.SIGTERM]):
            pass
        os._exit(128 + signal.SIGTERM)

    threading.Thread(target=watch, name="sigterm", daemon=True).start()


if __name__ == "__main__":
    start()

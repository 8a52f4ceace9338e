"""The command ``uwserver``, also available as ``python -m uwserver``."""

from __future__ import annotations

import os
import signal
import sys
import threading


def start() -> None:
    """Run the command line."""
    # Before the imports, which take a while: a container must be able to end in that time too.
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
    """End this process at once on SIGTERM, until the server installs its own handler.

    The kernel does not deliver an unhandled signal to the first process of a container. A thread waits for the signal, because Python runs its
    handlers only between two instructions of Python code, and the compiler of kernels works for many seconds without one.
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

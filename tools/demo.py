"""`make demo`: a server and the example client that drives a square in the pool; writes a picture."""

from __future__ import annotations

import argparse
import re
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[1] / "clients/python/examples/pool_square.py"


def main() -> int:
    """Exit status of the client."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="demo_square.png", help="picture to write")
    options = parser.parse_args()
    command = [sys.executable, "-m", "uwserver", "run", "bluerov2_pool", "--paused", "--port", "0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as server:
        try:
            assert server.stdout is not None
            for line in server.stdout:
                print(line, end="")
                if found := re.search(r"tcp: ([\d.]+):(\d+)", line):
                    break
            else:
                print("the server did not start", file=sys.stderr)
                return 1
            client = [sys.executable, str(EXAMPLE), "--host", found[1], "--port", found[2], "--out", options.out]
            return subprocess.run(client, check=False, timeout=600).returncode
        finally:
            server.terminate()
            server.wait(10)


if __name__ == "__main__":
    sys.exit(main())

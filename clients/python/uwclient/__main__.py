"""`python -m uwclient`: the command line."""

from __future__ import annotations

import sys

from uwclient.cli import main

sys.exit(main())

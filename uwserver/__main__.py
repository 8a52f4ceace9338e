"""``python -m uwserver`` is the command ``uwserver``."""

from uwserver.cli import main

main(prog_name="uwserver")

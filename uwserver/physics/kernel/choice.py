"""How kernels are compiled: the choice of the user, in the environment variable UWSERVER_KERNELS.

Every process reads it at its first import of a kernel. The command line asks before, to tell a wrong value in one line.
"""

from __future__ import annotations

VARIABLE = "UWSERVER_KERNELS"


def is_plain(choice: str | None) -> bool:
    """Return whether the variable, which has this value or None, chooses the plain kernels. An empty value counts as unset.

    Raises:
        ValueError: the value is unknown.
    """
    if choice not in (None, "", "plain"):
        raise ValueError(
            f'the environment variable {VARIABLE} is "{choice}": set it to "plain" for kernels by the public means of numba alone, '
            "or unset it for the usual kernels; there are no other values"
        )
    return choice == "plain"

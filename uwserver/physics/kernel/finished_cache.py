"""A finished kernel cache in a folder that cannot be written, as in a container image; numba's own caches insist on write access."""

from __future__ import annotations

from typing import Any

from numba.core import caching


class _Locator(caching.UserProvidedCacheLocator):  # type: ignore[misc]  # numba has no types
    def ensure_cache_path(self) -> None:
        """Nothing is written."""


class _Files(caching.CompileResultCacheImpl):  # type: ignore[misc]
    _locator_classes = (_Locator,)


class FinishedCache(caching.FunctionCache):  # type: ignore[misc]
    """Loads kernels; one that is missing (another kind of CPU) is compiled in memory and not kept."""

    _impl_class = _Files

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keeps nothing."""

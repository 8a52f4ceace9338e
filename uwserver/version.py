"""The version of all our distributions. It stands alone, so that any part can say it."""

__version__ = "0.1.0"

"""The adapter `morse`: the socket protocol of the simulator MORSE."""

from uwserver_adapters.morse.adapter import MorseAdapter

__all__ = ["MorseAdapter"]

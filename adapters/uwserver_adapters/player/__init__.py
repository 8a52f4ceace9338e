"""The adapter `player`: a server of the Player protocol."""

from uwserver_adapters.player.adapter import PlayerAdapter

__all__ = ["PlayerAdapter"]

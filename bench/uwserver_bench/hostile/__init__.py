"""Attacks: the cost of decoding them, and the effect of a flood on the ticks of a running server."""

from uwserver_bench.hostile.bench import bench_hostile

__all__ = ["bench_hostile"]

"""Attacks: what each costs whoever decodes it, and what a flood of it does to the ticks of a running server."""

from uwserver_bench.hostile.bench import bench_hostile

__all__ = ["bench_hostile"]

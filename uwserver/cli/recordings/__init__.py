"""Commands about recordings and logs: record, replay, compare, log, export and plot."""

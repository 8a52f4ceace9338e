"""The benchmark of the transports of the native protocol, and servers that write down the times of their ticks."""

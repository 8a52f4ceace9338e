"""A zenoh session, for all adapters that have one: its settings, how it is opened, its callbacks, and sending."""

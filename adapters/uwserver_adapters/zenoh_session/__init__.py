"""A session of zenoh, for all adapters that have one: its settings, how it is opened, and how it calls back."""

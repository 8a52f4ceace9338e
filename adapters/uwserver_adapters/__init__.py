"""Adapters that come with uwserver, one folder each; found through the entry points of ``uwserver.adapters``."""

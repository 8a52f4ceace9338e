"""The native protocol of uwserver (docs/reference/protocol.md): requests, sessions, encodings and limits; knows no socket."""

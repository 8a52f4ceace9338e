"""The benchmark of many vehicles."""
